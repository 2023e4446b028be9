"""Whatever happens to the bridge and the clients, every goal ends exactly once and the server is free again."""

from collections.abc import Callable
from math import isfinite

from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.codec import decode
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, Rejected, Result
from jezero.schemas.commands import Setpoint
from jezero.schemas.goals import GoToGoal
from jezero.schemas.state import StatusCode
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.table import action_server
from tests.services.actions.fake_bridge import FakeBridge

FREE_AGAIN_S = 50.0
GOAL = GoToGoal(target_ned_m=(6.0, -3.0, -4.0), goal_id="g", on_client_loss="cancel")
Fault = Callable[[MemoryBus, FakeBridge], object]

FAULTS: dict[str, Fault] = {
    "cancel": lambda bus, bridge: bus.send_request(topics.GO_TO.cancel, Cancel(goal_id="g")),
    "send again": lambda bus, bridge: bus.send_request(topics.GO_TO.endpoint, GOAL, "second"),
    "client gone": lambda bus, bridge: bus.client_departs("me"),
    "second client gone": lambda bus, bridge: bus.client_departs("second"),
    "abort": lambda bus, bridge: bridge.revoke(StatusCode.ABORT, "aborted"),
    "pilot": lambda bus, bridge: bridge.revoke(StatusCode.EXTERNAL, "taken over"),
    "hover": lambda bus, bridge: bridge.revoke(StatusCode.HOVER, "hover was asked for"),
    "bridge restarts": lambda bus, bridge: setattr(bridge, "boot_id", bridge.boot_id + 1),
    "vehicle restarts": lambda bus, bridge: setattr(bridge, "epoch_id", bridge.epoch_id + 1),
    "odometry stops": lambda bus, bridge: setattr(bridge, "mute_odometry", True),
    "odometry resumes": lambda bus, bridge: setattr(bridge, "mute_odometry", False),
    "status stops": lambda bus, bridge: setattr(bridge, "mute_status", True),
    "status resumes": lambda bus, bridge: setattr(bridge, "mute_status", False),
    "releases are lost": lambda bus, bridge: setattr(bridge, "lost_releases", 3),
    "replies are lost": lambda bus, bridge: setattr(bridge, "lost_replies", 3),
    "all releases are lost": lambda bus, bridge: setattr(bridge, "lost_releases", 10_000),
    "reset": lambda bus, bridge: bridge.step_position((0.7, -0.4, 0.1)),
    "bridge dies": lambda bus, bridge: bus.remove("vehicle_bridge") if "vehicle_bridge" in bus._ports else None,
}


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.sampled_from(sorted(FAULTS))), max_size=5))
def test_a_goal_ends_exactly_once_whatever_happens(faults: list[tuple[float, str]]) -> None:
    bus = MemoryBus(seed=2)
    bridge = FakeBridge((0.0, 0.0, -3.0))
    server = action_server("go_to", 5, ActionsConfig())
    bus.add(bridge)
    bus.add(server)
    setpoints: list[Setpoint] = []

    def note(t_ns: int, name: str, data: bytes) -> None:
        if name == topics.SETPOINT.name:
            setpoints.append(decode(Setpoint, data))

    bus.observe(note)
    bus.run_for(0.5)
    answers = bus.send_request(topics.GO_TO.endpoint, GOAL, "me")
    for after_s, name in faults:
        bus.run_for(after_s)
        FAULTS[name](bus, bridge)
    assert bus.run_for(FREE_AGAIN_S, lambda: answers.ended and server._run is None)
    assert isinstance(answers.replies[0], Accepted | Rejected)
    assert [r for r in answers.replies if isinstance(r, Result | Rejected)] == [answers.replies[-1]]
    last = answers.replies[-1]
    if isinstance(last, Result) and last.outcome != "succeeded":
        assert last.reason
    sequence = [s.sequence for s in setpoints]
    assert sequence == sorted(set(sequence))
    assert all(isfinite(x) for s in setpoints if s.pos_ned_m for x in s.pos_ned_m)
    sent = len(setpoints)
    bus.run_for(1.0)
    assert len(setpoints) == sent
