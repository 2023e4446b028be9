"""What became of goals: none flies twice or after an abort that came later, and each learns why it ended."""

from jezero.schemas.commands import Acquire
from jezero.services.vehicle_bridge.admission import Grant
from jezero.services.vehicle_bridge.vehicle import Situation

ENDED_REMEMBERED = 32
FLOWN_REMEMBERED = 100


class GoalsPast:
    """The latest goals and grants.

    Attributes:
        aborted_ns: vehicle time of the last abort, None before it.
    """

    def __init__(self) -> None:
        self.aborted_ns: int | None = None
        self._ended: dict[str, str] = {}
        """By control_id: why it ended, "" when it was given back."""
        self._flown: dict[str, None] = {}
        """Ids of goals that have sent a setpoint, oldest first."""

    def why_not(self, request: Acquire, now: Situation) -> str:
        """Why this goal may not have control any more, or ""."""
        if request.goal_id in self._flown:
            return f"goal {request.goal_id} has flown already, and a goal runs once: send it with a new id"
        started_ns = now.t_ns - now.timer_ns
        if request.goal_issued_t_ns is not None and request.goal_issued_t_ns < started_ns:
            return f"goal {request.goal_id} is from before the bridge started and may have flown: send it with a new id"
        if request.goal_t_ns is not None and self.aborted_ns is not None and request.goal_t_ns <= self.aborted_ns:
            return f"goal {request.goal_id} came before the last abort: send it again"
        return ""

    def flies(self, goal_id: str) -> None:
        """A restarted action server has forgotten which goals it ran, and clients may send theirs again."""
        if goal_id not in self._flown:
            self._flown[goal_id] = None
            if len(self._flown) > FLOWN_REMEMBERED:
                del self._flown[next(iter(self._flown))]

    def end(self, grant: Grant, why: str) -> None:
        """Control has ended; `why` is "" where it was given back."""
        self._ended[grant.control_id] = why
        if len(self._ended) > ENDED_REMEMBERED:
            del self._ended[next(iter(self._ended))]

    def why_ended(self, control_id: str) -> str:
        """Why control has ended, "" when it was given back."""
        return self._ended.get(control_id, f"control {control_id} was never given")
