"""Answers what is asked of the bridge: at once, or when what was asked for is done."""

from collections.abc import Callable, Iterator
from typing import Any

from jezero.runtime.service import Inbox, Output, Reply, Request
from jezero.schemas.commands import (
    Abort,
    AbortReply,
    Acquire,
    AcquireReply,
    Hover,
    HoverReply,
    Kill,
    KillReply,
    Release,
    ReleaseReply,
)
from jezero.schemas.state import StatusCode
from jezero.schemas.struct import Payload
from jezero.schemas.topics import ABORT, ACQUIRE, HOVER, KILL, RELEASE, Endpoint
from jezero.services.vehicle_bridge.authority import Authority
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink
from jezero.services.vehicle_bridge.vehicle import Situation

KILL_REPLY_NS = 3_000_000_000
Handle = Callable[[Any, Situation], Payload | None]
"""Answers what was asked; None: later."""
Handles = tuple[tuple[Endpoint[Any, Any], Handle], ...]


class Questions:
    """Puts to the authority what is asked, and tells how it went.

    Args:
        boot_id: differs between two runs of the bridge.
    """

    def __init__(self, authority: Authority, link: AutopilotLink, boot_id: int) -> None:
        self._authority = authority
        self._link = link
        self._boot_id = boot_id
        self._waiting: list[tuple[Request, int]] = []
        """Releases, hovers and kills that are being done, and the wall time at which each came."""
        self._urgent: Handles = ((KILL, self._on_kill), (ABORT, self._on_abort), (HOVER, self._on_hover))
        self._orderly: Handles = ((RELEASE, self._on_release), (ACQUIRE, self._on_acquire))

    def urgent(self, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """What goes before the setpoints that came with it."""
        return self._attend(self._urgent, now, inbox)

    def orderly(self, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """What comes after them."""
        return self._attend(self._orderly, now, inbox)

    def late(self, now: Situation, wall_ns: int) -> Iterator[Output]:
        """Reply to what has been done by now."""
        waiting, self._waiting = self._waiting, []
        for request, since_ns in waiting:
            payload = self._outcome(request.payload, now, wall_ns - since_ns)
            if payload is None:
                self._waiting.append((request, since_ns))
            else:
                yield Reply(request.request_id, payload)

    def _attend(self, handles: Handles, now: Situation, inbox: Inbox) -> Iterator[Output]:
        """Reply at once where there is an answer, else when it is done."""
        for endpoint, handle in handles:
            for request in inbox.requests(endpoint):
                payload = handle(request.payload, now)
                if payload is None:
                    self._waiting.append((request, inbox.wall_ns))
                else:
                    yield Reply(request.request_id, payload)

    def _on_kill(self, request: Kill, now: Situation) -> KillReply | None:
        if not request.confirm:
            return KillReply(killed=False, reason="kill cuts the motors, in the air too: set confirm to true")
        self._authority.kill("killed on request", now)
        return None

    def _on_abort(self, request: Abort, now: Situation) -> AbortReply:
        text = self._authority.abort(request.reason, now)
        flying = self._authority.code not in (StatusCode.IDLE, StatusCode.EXTERNAL, StatusCode.LANDING_DONE)
        return AbortReply(hovering=flying and not now.landed, reason=text)

    def _on_hover(self, request: Hover, now: Situation) -> HoverReply | None:
        refusal = self._authority.hover(request, now)
        return HoverReply(hover_mode=False, reason=refusal) if refusal else None

    def _on_release(self, request: Release, now: Situation) -> ReleaseReply | None:
        refusal = self._authority.release(request, now, self._link.telemetry.resets)
        return ReleaseReply(released=False, code=int(self._authority.code), reason=refusal) if refusal else None

    def _on_acquire(self, request: Acquire, now: Situation) -> AcquireReply:
        refusal = self._authority.acquire(request, now)
        grant = self._authority.grant
        if refusal or grant is None:
            return AcquireReply(granted=False, reason=refusal, bridge_boot_id=self._boot_id)
        grants = self._authority.standing.grants
        return AcquireReply(granted=True, control_id=grant.control_id, bridge_boot_id=self._boot_id, grants=grants)

    def _outcome(self, asked: Kill | Hover | Release, now: Situation, waited_ns: int) -> Payload | None:
        """The answer to what was asked, None while it is still being done."""
        authority = self._authority
        code = authority.code
        if isinstance(asked, Kill):
            if now.armed is False and not authority.killing:
                return KillReply(killed=True, reason="the motors are off")
            reason = "the autopilot has not confirmed it, the bridge keeps trying"
            reason += f": {now.complaint}" if now.complaint else ""
            return KillReply(killed=False, reason=reason) if waited_ns > KILL_REPLY_NS else None
        lost = code is StatusCode.EXTERNAL and not authority.taking_back
        moved_on = authority.grant is not None  # already done, and another goal is in charge
        if isinstance(asked, Hover):
            if code is StatusCode.HOVER or lost or moved_on or code is StatusCode.IDLE:
                return HoverReply(hover_mode=code is StatusCode.HOVER, reason=authority.text)
            return None
        if lost or moved_on or code in (StatusCode.HOVER, StatusCode.IDLE):
            return ReleaseReply(released=not lost, code=int(code), reason=authority.text if lost else "")
        return None
