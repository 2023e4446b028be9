"""All action servers against a bridge with a point mass, on the bus in virtual time."""

from typing import Any

from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Result
from jezero.schemas.goals import GoToGoal
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.table import PLANNERS, action_server
from tests.services.actions.fake_bridge import FakeBridge

CONFIG = ActionsConfig()
HOVERING = (0.0, 0.0, -3.0)
FAR = GoToGoal(target_ned_m=(20.0, 0.0, -3.0), goal_id="far")


class World:
    """A bus with a fake bridge and all action servers, half a second old."""

    def __init__(self, pos_ned_m: tuple[float, float, float] = HOVERING) -> None:
        self.bus = MemoryBus(seed=1)
        self.bridge = FakeBridge(pos_ned_m)
        self.bus.add(self.bridge)
        self.servers: dict[str, ActionServer] = {}
        for name in PLANNERS:
            self.servers[name] = action_server(name, 5, CONFIG)
            self.bus.add(self.servers[name])
        self.bus.run_for(0.5)

    def send(self, goal: Any, client: str = "me") -> SentRequest:
        action = next(a for a in topics.ACTIONS.values() if a.goal_type is type(goal))
        return self.bus.send_request(action.endpoint, goal, client)

    def fly(self, goal: Any, within_s: float = 60.0) -> Any:
        """The last reply to a goal."""
        answers = self.send(goal)
        assert self.bus.run_for(within_s, lambda: answers.ended), answers.replies
        return answers.replies[-1]

    def flying(self, goal: Any = FAR, client: str = "me") -> SentRequest:
        """A goal that has been running for a second."""
        answers = self.send(goal, client)
        self.bus.run_for(1.0)
        assert isinstance(answers.replies[0], Accepted)
        assert not answers.ended
        return answers

    def end(self, answers: SentRequest, within_s: float = 5.0) -> Any:
        assert self.bus.run_for(within_s, lambda: answers.ended), answers.replies[-3:]
        results = [reply for reply in answers.replies if isinstance(reply, Result)]
        assert len(results) == 1
        assert answers.replies[-1] is results[0]
        return results[0]

    def is_idle(self, name: str) -> bool:
        return self.servers[name]._run is None
