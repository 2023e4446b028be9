"""Past goals: none flies twice or after a later abort, and each owner gets the reason why its control ended."""

from jezero.schemas.commands import Acquire
from jezero.services.vehicle_bridge.admission import Grant
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot

ENDED_MAX = 32
FLOWN_MAX = 100


class GoalHistory:
    """The last goals and grants.

    Attributes:
        last_abort_ns: vehicle time of the last abort, None before the first.
    """

    def __init__(self) -> None:
        self.last_abort_ns: int | None = None
        self._end_reasons: dict[str, str | None] = {}
        """Reason why control ended, by control id; None where its owner released it."""
        self._flown: dict[str, None] = {}
        """Ids of goals that have sent a setpoint, oldest first."""

    def refusal(self, request: Acquire, vehicle: VehicleSnapshot) -> str | None:
        """Reason why this goal may not have control any more, None when it may."""
        goal_id = request.goal_id
        if goal_id in self._flown:
            return "this goal has flown already, and a goal runs once: send it with a new id"
        started_ns = vehicle.t_ns - vehicle.timer_ns
        if request.goal_issued_t_ns is not None and request.goal_issued_t_ns < started_ns:
            return "this goal is from before the bridge started and may have flown: send it with a new id"
        if request.goal_t_ns is not None and self.last_abort_ns is not None and request.goal_t_ns <= self.last_abort_ns:
            return "this goal came before the last abort: send it again"
        return None

    def add_flown(self, goal_id: str) -> None:
        """Remember a goal that flies: a restarted action server doesn't, and clients may send theirs again."""
        if goal_id not in self._flown:
            self._flown[goal_id] = None
            if len(self._flown) > FLOWN_MAX:
                del self._flown[next(iter(self._flown))]

    def add_ended(self, grant: Grant, reason: str | None) -> None:
        """Remember the reason why control ended; None where its owner released it."""
        self._end_reasons[grant.control_id] = reason
        if len(self._end_reasons) > ENDED_MAX:
            del self._end_reasons[next(iter(self._end_reasons))]

    def end_reason(self, control_id: str) -> str | None:
        """Reason why control ended, None where its owner released it."""
        return self._end_reasons.get(control_id, "this control was never given")
