"""What a goal holds while it flies, and others may take away or let lapse.

The vehicle bridge grants control of the vehicle (`ControlLease`). The estimator selects its inputs as the goal wants
them (`SelectionLease`).
"""

from collections.abc import Iterator

import msgspec

from jezero.base.frames import Vec3, add
from jezero.runtime.service import Call, Inbox, Output
from jezero.schemas.commands import AcquireReply
from jezero.schemas.estimate import Lease, LeaseReply, Relative
from jezero.schemas.state import STATUS_WORDS, Clock, Status, StatusCode
from jezero.schemas.topics import CLOCK, LEASE, RELATIVE, STATUS
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import Selection

STATUS_AGE_MAX_S = 1.0
"""An older status counts as lost; the bridge publishes ten per second."""
BRIDGE_RESTART_MARGIN_NS = 100_000_000
"""A status of another run of the bridge that is at most this much newer than the grant is from the previous run."""


class ControlLease:
    """The control lease of one goal: the right to send setpoints, which the bridge may take away.

    Args:
        epoch_id: of the vehicle that the goal is for.

    Attributes:
        id: control id that setpoints and the release carry; "" before the grant.
    """

    def __init__(self, epoch_id: int) -> None:
        self._epoch_id = epoch_id
        self.id = ""
        self._grant = AcquireReply(granted=False)
        self._age_max_ns = STATUS_AGE_MAX_S * NS_PER_S
        self._granted_ns = 0
        self._confirmed = False
        """Whether a status has confirmed that the goal is in charge."""
        self._checked: tuple[Status | None, Clock | None] = (None, None)
        """The newest messages that were checked and by which the goal was in charge."""

    def begin(self, grant: AcquireReply, t_ns: int) -> None:
        """Begin with the bridge's grant."""
        self.id = grant.control_id
        self._grant = grant
        self._granted_ns = t_ns

    def is_ours(self, status: Status) -> bool:
        """Whether the goal is in charge by this status."""
        return status.bridge_boot_id == self._grant.bridge_boot_id and status.grant == self._grant.grants

    def loss_reason(self, t_ns: int, inbox: Inbox) -> str:
        """Reason why this goal isn't in charge any more and needs no release, or ""."""
        latest, clock = inbox.latest(STATUS), inbox.latest(CLOCK)
        checked, checked_clock = self._checked
        if (
            latest is checked
            and clock is checked_clock
            and latest is not None
            and t_ns - latest.t_ns <= self._age_max_ns
        ):
            return ""
        if (reason := self._connection_loss(t_ns, inbox)) or latest is None:
            return reason
        for status in inbox.new(STATUS) or (latest,):
            if lost := self._loss_by_status(status):
                return lost
        self._checked = (latest, clock)
        return ""

    def bridge_loss_reason(self, t_ns: int, inbox: Inbox) -> str:
        """Reason why the bridge that granted control can't confirm its release, or ""."""
        status = inbox.latest(STATUS)
        if reason := self._connection_loss(t_ns, inbox):
            return reason
        another = status is not None and self._confirmed and status.bridge_boot_id != self._grant.bridge_boot_id
        return "the vehicle bridge restarted" if another else ""

    def _loss_by_status(self, status: Status) -> str:
        ours = self.is_ours(status)
        self._confirmed |= ours
        if status.bridge_boot_id != self._grant.bridge_boot_id:
            before = not self._confirmed and status.t_ns <= self._granted_ns + BRIDGE_RESTART_MARGIN_NS
            return "" if before else "the vehicle bridge restarted"
        if status.grants < self._grant.grants:
            return ""
        if ours and status.code not in (StatusCode.ABORT, StatusCode.EXTERNAL):
            return ""
        return status.text or f"control was taken away, the vehicle {STATUS_WORDS[StatusCode(status.code)]}"

    def _connection_loss(self, t_ns: int, inbox: Inbox) -> str:
        """Reason why the bridge is silent or the vehicle is another one, or ""."""
        clock, status = inbox.latest(CLOCK), inbox.latest(STATUS)
        if status is None or t_ns - status.t_ns > self._age_max_ns:
            return f"the vehicle bridge has been silent for {STATUS_AGE_MAX_S:g} s"
        epochs = {status.epoch_id, self._epoch_id if clock is None else clock.epoch_id}
        epochs.discard(0)  # a bridge that has just started doesn't know the epoch
        return "the vehicle restarted" if epochs - {self._epoch_id} else ""


SELECTION_PERIOD_NS = 1_000_000_000
SELECTION_RETRY_NS = 200_000_000
SELECTION_TIMEOUT_S = 1.0


class SelectionLease:
    """The lease of a goal's own selection of the estimator's inputs: renewed while the goal flies, ended with it.

    An estimator whose estimate says that it doesn't select is used without one. Source: spec §7; the thesis' call of
    SetParameters in algorithm 9.
    """

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
        self._due_ns = t_ns + SELECTION_PERIOD_NS
        self._tag = f"{self._goal_id}/lease/{t_ns}"
        pos_ned_m = self._selection.pos_rover_ned_m
        lease = Lease(
            goal_id=self._goal_id,
            use_uwb=self._selection.use_uwb,
            use_tag=self._selection.use_tag,
            pos_rover_ned_m=None if pos_ned_m is None else add(pos_ned_m, shift_ned_m),
        )
        yield Call(LEASE, lease, self._tag, SELECTION_TIMEOUT_S)

    def end(self, t_ns: int) -> Iterator[Output]:
        """End the lease; it would also expire by itself, should this call get lost."""
        if self._due_ns is None:
            return
        selection = self._selection
        lease = Lease(goal_id=self._goal_id, use_uwb=selection.use_uwb, use_tag=selection.use_tag, release=True)
        yield Call(LEASE, lease, f"{self._goal_id}/unlease/{t_ns}", SELECTION_TIMEOUT_S)

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
        self._due_ns = min(self._due_ns or t_ns, t_ns + SELECTION_RETRY_NS)
