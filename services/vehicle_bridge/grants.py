"""Grants of control: one goal at a time has the right to send setpoints."""

from collections.abc import Collection

from jezero.schemas.commands import Acquire
from jezero.schemas.state import InCharge, StatusCode
from jezero.services.vehicle_bridge.admission import Grant, acquire_refusal, overriding, phases_of
from jezero.services.vehicle_bridge.goal_history import GoalHistory
from jezero.services.vehicle_bridge.vehicle import ControlState, VehicleSnapshot

UNUSED_TIMEOUT_S = 0.5
"""A grant ends when its goal has sent no setpoint within this time: the reply may have been lost."""
LATE_S = 0.35
"""When a goal has sent no further setpoint for this time the bridge stops the vehicle, within 0.5 s in all: the
autopilot would go on with the last velocity. Source: architecture §5. When the action's server has vanished, the grant
ends after this time."""
SILENT_MAX_S = 1.0
"""A grant ends when its goal sends no setpoint for this time. A server that a busy machine holds up for a moment sends
the next one before."""


class Grants:
    """The grant of the goal in charge, and the goals that had one before.

    Attributes:
        present: grant of the goal in charge, or None.
        count: number of grants in this run of the bridge.
        history: past goals.
    """

    def __init__(self, secret: str) -> None:
        self.present: Grant | None = None
        self.count = 0
        self.history = GoalHistory()
        self._secret = secret

    def acquire(self, request: Acquire, code: StatusCode, text: str, vehicle: VehicleSnapshot) -> str | None:
        """Give control to a goal; returns the reason for a refusal, or None with a new `present`.

        A request that only checks changes nothing.

        Args:
            text: the status' last event, which explains a status 13.
        """
        holder = self.present
        if holder is not None and holder.sequence < 0 and holder.goal_id == request.goal_id:
            return None  # the same request again, because its reply was lost
        refusal = self.history.refusal(request, vehicle) or acquire_refusal(request, code, holder, text, vehicle)
        if refusal or request.check_only:
            return refusal
        self.count += 1
        self.present = Grant(
            control_id=f"{self._secret}-{self.count}",
            goal_id=request.goal_id,
            action=request.action,
            phases=phases_of(request.action, code),
            timer_ns=vehicle.timer_ns,
            overriding=overriding(request, code, vehicle),
        )
        return None

    def in_charge(self, code: StatusCode) -> InCharge:
        """Who controls a vehicle that the bridge commands."""
        if self.present is not None:
            return "goal"
        return "none" if code is StatusCode.IDLE else "hover"

    def control_state(self, code: StatusCode, in_charge: InCharge, interventions: int, text: str) -> ControlState:
        """What `status` says of control."""
        grant = self.present
        return ControlState(
            code=code,
            in_charge=in_charge,
            goal_id="" if grant is None else grant.goal_id,
            action="" if grant is None else grant.action,
            grant=0 if grant is None else self.count,
            grants=self.count,
            interventions=interventions,
            text=text,
            paused=grant is not None and grant.paused,
        )

    def end(self, reason: str | None) -> None:
        """End the present grant, if there is one; `reason` is None when its owner releases it."""
        if self.present is not None:
            self.history.add_ended(self.present, reason)
        self.present = None

    def silence(self, vehicle: VehicleSnapshot, departed: Collection[str]) -> tuple[str, str]:
        """Judge for how long the goal in charge has sent no setpoint that could be flown.

        Args:
            departed: names of the services that vanished since the last step.

        Returns:
            The reason why the present grant ends, and the event when its goal becomes late; "" for none.
        """
        grant = self.present
        if grant is None:
            return "", ""
        grant.is_orphaned |= grant.action in departed
        age_s = (vehicle.timer_ns - grant.timer_ns) * 1e-9
        if age_s <= (UNUSED_TIMEOUT_S if grant.sequence < 0 else LATE_S):
            return "", ""
        because = f"it sent no setpoint for {age_s:.2f} s"
        if grant.refusal:
            because = f"none of its setpoints could be flown for {age_s:.2f} s: {grant.refusal}"
        if grant.sequence < 0 or grant.is_orphaned or age_s > SILENT_MAX_S:
            return f"{grant.name} ended: {because}", ""
        if grant.is_late:
            return "", ""
        grant.is_late = True
        return "", f"hovering until {grant.name} goes on: {because}"
