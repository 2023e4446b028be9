"""The lease of a goal's own selection of the estimator's inputs: renewed while the goal flies, ended with it.

Source: spec §7; the thesis' call of SetParameters in algorithm 9.
"""

from collections.abc import Iterator

import msgspec

from jezero.frames import Vec3, add
from jezero.runtime.service import Call, Inbox, Output
from jezero.schemas.estimate import Lease, LeaseReply, Relative
from jezero.schemas.topics import LEASE, RELATIVE
from jezero.services.actions.motion.behaviour import Selection

PERIOD_NS = 1_000_000_000
RETRY_NS = 200_000_000
TIMEOUT_S = 1.0


class SelectionLease:
    """The lease of one goal; an estimator whose estimate says that it doesn't select is used without one."""

    def __init__(self, goal_id: str, selection: Selection) -> None:
        self._goal_id = goal_id
        self._selection = selection
        self._due_ns: int | None = None
        self._tag = ""
        self._refusal = "the estimator has not replied yet"

    def renew(self, t_ns: int, inbox: Inbox, shift_ned_m: Vec3) -> Iterator[Output]:
        """Call the estimator once a second, and sooner when the last call failed.

        Args:
            shift_ned_m: of the autopilot's positions since the goal began.
        """
        for response in inbox.responses:
            if response.tag == self._tag:
                self._on_reply(t_ns, response.payload, response.error)
        if self._due_ns is not None and t_ns < self._due_ns:
            return
        if self._is_fixed(inbox):
            return
        self._due_ns = t_ns + PERIOD_NS
        self._tag = f"{self._goal_id}/lease/{t_ns}"
        pos_ned_m = self._selection.pos_rover_ned_m
        lease = Lease(
            goal_id=self._goal_id,
            use_uwb=self._selection.use_uwb,
            use_tag=self._selection.use_tag,
            pos_rover_ned_m=None if pos_ned_m is None else add(pos_ned_m, shift_ned_m),
        )
        yield Call(LEASE, lease, self._tag, TIMEOUT_S)

    def end(self, t_ns: int) -> Iterator[Output]:
        """End the lease; it would also expire by itself, should this call get lost."""
        if self._due_ns is None:
            return
        selection = self._selection
        lease = Lease(goal_id=self._goal_id, use_uwb=selection.use_uwb, use_tag=selection.use_tag, release=True)
        yield Call(LEASE, lease, f"{self._goal_id}/unlease/{t_ns}", TIMEOUT_S)

    def checked(self, relative: Relative) -> Relative:
        """The estimate as this goal may use it: invalid and without measurements if it is of another selection."""
        if relative.goal_id == self._goal_id or not relative.selects:
            return relative
        reason = self._refusal or "the estimator doesn't use this goal's selection yet"
        return msgspec.structs.replace(relative, valid=False, reason=reason, fused_t_ns=0)

    @staticmethod
    def _is_fixed(inbox: Inbox) -> bool:
        """Whether the estimator has one fixed set of inputs, by its newest estimate."""
        relative = inbox.latest(RELATIVE)
        return relative is not None and not relative.selects

    def _on_reply(self, t_ns: int, reply: LeaseReply | None, error: str | None) -> None:
        if reply is not None and reply.accepted:
            self._refusal = ""
            return
        self._refusal = (
            f"the estimator did not lease the landing's selection of sensors: {error}; an estimator with fixed inputs "
            "publishes `selects` = false"
            if reply is None
            else f"the estimator refused the selection: {reply.reason}"
        )
        self._due_ns = min(self._due_ns or t_ns, t_ns + RETRY_NS)
