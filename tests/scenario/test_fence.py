"""The fence of a whole stack with a point mass, in virtual time."""

from typing import Any

import msgspec
import pytest

from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Modify, Rejected
from jezero.schemas.fence import Fence, FenceReply, FenceState, SetFence, Zone
from jezero.schemas.goals import GoToGoal, TakeoffGoal
from jezero.trials.campaign.models import POINT_MASS

FIELD = Zone(name="field", corners_ned_m=((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)))
CRATER = Zone(name="crater", corners_ned_m=((4.0, -2.0), (8.0, -2.0), (8.0, 2.0), (4.0, 2.0)))
FENCE = Fence(name="mars", keep_in=FIELD, keep_out=(CRATER,), ceiling_m=10.0)


class Flight:
    """A stack that is ready, with the fence set."""

    def __init__(self) -> None:
        self.bus: MemoryBus = POINT_MASS.make_bus(1)
        self.makers = POINT_MASS.make_service_makers(1)
        for name, make in self.makers.items():
            if name in ("point_mass", "vehicle_bridge", "takeoff", "go_to"):
                self.bus.add(make(1))
        self.bus.run_for(15.0)
        assert self.ask(topics.SET_FENCE, SetFence(fence=FENCE)) == FenceReply(accepted=True)
        self.bus.run_for(1.0)

    def ask(self, endpoint: Any, payload: Any, within_s: float = 60.0) -> Any:
        """The last reply."""
        sent = self.bus.send_request(endpoint, payload)
        assert self.bus.run_for(within_s, lambda: sent.ended), sent.replies
        return sent.replies[-1]


def test_goals_that_leave_the_fence_are_refused_with_the_place_and_others_fly() -> None:
    flight = Flight()
    high = flight.ask(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=12.0))
    assert isinstance(high, Rejected) and "within 0.5 m of the ceiling of 10 m" in high.reason
    assert flight.ask(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=3.0)).outcome == "succeeded"
    through = GoToGoal(target_ned_m=(12.0, 0.0, -3.0))
    for endpoint in (topics.GO_TO.endpoint, topics.GO_TO.plan):
        reply = flight.ask(endpoint, through)
        assert "leaves the fence 'mars'" in reply.reason
        assert "the zone 'crater' to stay out of, at north 3." in reply.reason
    assert flight.ask(topics.GO_TO.endpoint, GoToGoal(target_ned_m=(0.0, 8.0, -3.0))).outcome == "succeeded"


def test_the_fence_stays_as_it_is_in_flight() -> None:
    flight = Flight()
    flight.ask(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=3.0))
    reply = flight.ask(topics.SET_FENCE, SetFence(fence=None))
    assert not reply.accepted and "land and disarm first" in reply.reason


def test_a_change_that_leads_out_of_the_fence_is_refused_and_the_goal_goes_on() -> None:
    flight = Flight()
    flight.ask(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=3.0))
    goal = flight.bus.send_request(
        topics.GO_TO.endpoint, GoToGoal(goal_id="way", target_ned_m=(0.0, 15.0, -3.0), speed_mps=1.0)
    )
    flight.bus.run_for(2.0)
    assert isinstance(goal.replies[0], Accepted)
    reply = flight.ask(topics.GO_TO.modify, Modify(goal_id="way", fields={"target_ned_m": [0.0, 30.0, -3.0]}))
    assert not reply.modified and "edge of the area 'field'" in reply.reason
    assert flight.bus.run_for(40.0, lambda: goal.ended)
    assert goal.replies[-1].outcome == "succeeded"


def test_a_bridge_that_is_restarted_in_flight_holds_the_fence_that_was_set() -> None:
    flight, states = Flight(), list[FenceState]()
    flight.ask(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=3.0))
    flight.bus.remove("vehicle_bridge")
    flight.bus.run_for(0.5)
    flight.bus.observe(lambda t_ns, topic, data: states.append(_state(data)) if topic == topics.FENCE.name else None)
    flight.bus.add(flight.makers["vehicle_bridge"](2))
    flight.bus.run_for(2.5)
    assert states[-1].fence == FENCE


@pytest.mark.parametrize("fence", [FENCE, None])
def test_the_fence_is_published_with_its_id(fence: Fence | None) -> None:
    flight, states = Flight(), list[FenceState]()
    flight.ask(topics.SET_FENCE, SetFence(fence=fence))
    flight.bus.observe(lambda t_ns, topic, data: states.append(_state(data)) if topic == topics.FENCE.name else None)
    flight.bus.run_for(2.5)
    assert len(states) >= 2
    assert states[-1].fence == fence
    assert bool(states[-1].fence_id) is (fence is not None)


def _state(data: bytes) -> FenceState:
    return msgspec.json.decode(data, type=FenceState)
