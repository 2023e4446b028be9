"""Requests to the bridge, replied to at once or when they have taken effect, and those to actions that don't exist."""

from collections.abc import Callable, Collection, Iterator
from typing import Any

import msgspec

from jezero.base.mistakes import unknown
from jezero.runtime.service import Inbox, Output, Reply, Request
from jezero.schemas.actions import CancelReply, ModifyReply, PauseReply, PlanReply, Rejected, ResumeReply
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
from jezero.schemas.rows import Endpoint
from jezero.schemas.state import StatusCode
from jezero.schemas.struct import TEXT_MAX, Payload
from jezero.schemas.topics import ABORT, ACQUIRE, HOVER, KILL, RELEASE, RESULT
from jezero.services.vehicle_bridge.authority import Authority
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S, VehicleSnapshot

KILL_TIMEOUT_NS = 3_000_000_000
"""A kill that the autopilot has not confirmed by then gets a reply; the bridge keeps trying."""
Handler = Callable[[Any, VehicleSnapshot], Payload | None]
"""Handles a request and returns the reply, None when it must wait until the request has taken effect."""
Handlers = tuple[tuple[Endpoint[Any, Any], Handler], ...]


class RequestQueue:
    """Passes requests to the authority, and keeps those that wait for their effect.

    Args:
        boot_id: differs between two runs of the bridge.
        name: name of the vehicle, as in its keys.
    """

    def __init__(self, authority: Authority, link: AutopilotLink, boot_id: int, name: str) -> None:
        self._authority = authority
        self._link = link
        self._boot_id = boot_id
        self._name = name
        self._pending: list[tuple[Request, int]] = []
        """Releases, hovers and kills without a reply yet, with the wall time of their arrival."""
        self._before_setpoints: Handlers = ((KILL, self._on_kill), (ABORT, self._on_abort), (HOVER, self._on_hover))
        self._after_setpoints: Handlers = ((RELEASE, self._on_release), (ACQUIRE, self._on_acquire))

    def handle_before_setpoints(self, vehicle: VehicleSnapshot, inbox: Inbox) -> Iterator[Output]:
        """Handle kill, abort and hover, which overrule the setpoints of the same step."""
        return self._handle(self._before_setpoints, vehicle, inbox)

    def handle_after_setpoints(self, vehicle: VehicleSnapshot, inbox: Inbox) -> Iterator[Output]:
        """Handle release and acquire: a release follows its goal's last setpoint."""
        return self._handle(self._after_setpoints, vehicle, inbox)

    def reply_to_pending(self, vehicle: VehicleSnapshot, wall_ns: int) -> Iterator[Output]:
        """Reply to the requests that have taken effect, failed or timed out by now."""
        pending, self._pending = self._pending, []
        for request, arrival_ns in pending:
            payload = self._final_reply(request.payload, vehicle, wall_ns - arrival_ns)
            if payload is None:
                self._pending.append((request, arrival_ns))
            else:
                yield _reply(request, payload)

    def _handle(self, handlers: Handlers, vehicle: VehicleSnapshot, inbox: Inbox) -> Iterator[Output]:
        for endpoint, handler in handlers:
            for request in inbox.requests(endpoint):
                payload = handler(request.payload, vehicle)
                if payload is None:
                    self._pending.append((request, inbox.wall_ns))
                else:
                    yield _reply(request, payload)

    def _on_kill(self, request: Kill, vehicle: VehicleSnapshot) -> KillReply | None:
        if not request.confirm:
            return KillReply(killed=False, reason="kill cuts the motors, in the air too: set confirm to true")
        if request.vehicle != self._name and (refusal := self._kill_refusal(request.vehicle, vehicle)):
            return KillReply(killed=False, reason=refusal)
        self._authority.interventions += 1
        self._authority.kill("motors cut on request", vehicle)
        return None

    def _kill_refusal(self, named: str, vehicle: VehicleSnapshot) -> str:
        """Reason why the motors are not cut of a vehicle that the request does not name, or "" on the ground."""
        if named:
            return f"this vehicle is {self._name}, not {named}: its motors run on"
        if vehicle.armed is False or (vehicle.landed and vehicle.telemetry_age_s <= LINK_TIMEOUT_S):
            return ""
        return (
            f"{self._name} is in the air and would fall: to stop its motors all the same, name it too: "
            f"`jezero kill --yes {self._name}`, or vehicle={self._name} in the request. `jezero abort` makes it hover"
        )

    def _on_abort(self, request: Abort, vehicle: VehicleSnapshot) -> AbortReply:
        text = self._authority.abort(request.reason, vehicle)
        flying = self._authority.code not in (StatusCode.IDLE, StatusCode.EXTERNAL, StatusCode.LANDING_DONE)
        return AbortReply(hovering=flying and not vehicle.landed, reason=text)

    def _on_hover(self, request: Hover, vehicle: VehicleSnapshot) -> HoverReply | None:
        refusal = self._authority.hover(request, vehicle)
        return HoverReply(hover_mode=False, reason=refusal) if refusal else None

    def _on_release(self, request: Release, vehicle: VehicleSnapshot) -> ReleaseReply | None:
        refusal = self._authority.release(request, vehicle, self._link.telemetry.resets)
        return ReleaseReply(released=False, code=int(self._authority.code), reason=refusal) if refusal else None

    def _on_acquire(self, request: Acquire, vehicle: VehicleSnapshot) -> AcquireReply:
        refusal = self._authority.acquire(request, vehicle)
        grant = self._authority.grant
        if request.check_only:
            return AcquireReply(granted=not refusal, reason=refusal, bridge_boot_id=self._boot_id)
        if refusal or grant is None:
            return AcquireReply(granted=False, reason=refusal, bridge_boot_id=self._boot_id)
        grants = self._authority.control_state.grants
        return AcquireReply(
            granted=True,
            control_id=grant.control_id,
            bridge_boot_id=self._boot_id,
            grants=grants,
            warning=grant.overriding[:TEXT_MAX],
        )

    def _final_reply(self, payload: Kill | Hover | Release, vehicle: VehicleSnapshot, age_ns: int) -> Payload | None:
        """Reply to a pending request, None while it has no effect yet."""
        authority = self._authority
        code = authority.code
        if isinstance(payload, Kill):
            if vehicle.armed is False and not authority.killing:
                return KillReply(killed=True, reason="the motors are off")
            reason = "the autopilot has not confirmed it, the bridge keeps trying"
            reason += f": {vehicle.command_failure}" if vehicle.command_failure else ""
            return KillReply(killed=False, reason=reason) if age_ns > KILL_TIMEOUT_NS else None
        lost = code is StatusCode.EXTERNAL and not authority.taking_back
        superseded = authority.grant is not None  # it has taken effect, and another goal is in charge since
        if isinstance(payload, Hover):
            if code is StatusCode.HOVER or lost or superseded or code is StatusCode.IDLE:
                return HoverReply(hover_mode=code is StatusCode.HOVER, reason=authority.text)
            return None
        if lost or superseded or code in (StatusCode.HOVER, StatusCode.IDLE):
            return ReleaseReply(released=not lost, code=int(code), reason=authority.text if lost else "")
        return None


def _reply(request: Request, payload: Any) -> Reply:
    """A reply with a reason, which is as long as a message may have it."""
    return Reply(request.request_id, msgspec.structs.replace(payload, reason=payload.reason[:TEXT_MAX]))


# -- actions that don't exist ----------------------------------------------------------------------------

REFUSALS: dict[str, Callable[[str], Payload]] = {
    "": lambda why: Rejected(reason=why),
    "plan": lambda why: PlanReply(accepted=False, reason=why),
    "cancel": lambda why: CancelReply(canceled=False, reason=why),
    "pause": lambda why: PauseReply(paused=False, reason=why),
    "resume": lambda why: ResumeReply(resumed=False, reason=why),
    "modify": lambda why: ModifyReply(modified=False, reason=why),
}
"""Replies by the part of the key behind the action's name."""


def unknown_action_reply(key: str, actions: Collection[str]) -> Payload | None:
    """Reply to a request to an action that doesn't exist, whose client would else hear nothing.

    None for a request that is left to an action server, or that nobody could understand.

    Args:
        key: of the request, `@action/<name>` or `@action/<name>/<request>`.
        actions: names of all actions.
    """
    name, _, request = key.removeprefix("@action/").partition("/")
    if name in actions or key == RESULT.name or request not in REFUSALS:
        return None
    return REFUSALS[request](f"{unknown('action', name, actions)}. `action/*/description` has their fields")
