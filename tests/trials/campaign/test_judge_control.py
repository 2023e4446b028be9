"""The campaign's rule of setpoints finds targets of nobody, and excuses those that the vehicle's limits ask for."""

from collections.abc import Iterator
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.runtime.service import Output, Publish, Reply, Send, Spec
from jezero.schemas import topics
from jezero.schemas.commands import AcquireReply, Phase, Setpoint
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.rows import Topic
from jezero.schemas.state import StatusCode
from jezero.trials.campaign.judge import Judge
from jezero.trials.campaign.judge_control import BridgeJudge
from tests.trials.campaign.test_fence import odometry, status

S = 1_000_000_000
RULE = "only the owner's fresh setpoints"
LIMITS = VehicleLimitsConfig(altitude_max_m=120.0, distance_max_m=500.0)


class FakeBridge:
    """Grants control to a goal, then sends the autopilot a target, whatever the goal's setpoint is."""

    spec = Spec(name="vehicle_bridge")

    def __init__(
        self, here_ned_m: Vec3, target_ned_m: Vec3, vel_ned_mps: Vec3 = (0.0, 0.0, 0.0), fence: Fence | None = None
    ) -> None:
        self._here_ned_m, self._target_ned_m, self._vel_ned_mps = here_ned_m, target_ned_m, vel_ned_mps
        self._fence = fence

    def step(self, t_ns: int, inbox: Any) -> Iterator[Output]:
        yield Publish(topics.ODOMETRY, odometry(t_ns, self._here_ned_m))
        if t_ns == 10 * S:
            yield Reply(1, AcquireReply(granted=True, control_id="c", grants=1))
            yield Publish(topics.FENCE, FenceState(t_ns=t_ns, fence=self._fence))
        yield Publish(topics.STATUS, replace(status(t_ns, StatusCode.GO_TO), grant=1))
        message = dialect.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, dialect.MAV_FRAME_LOCAL_NED, 0, *self._target_ned_m, *self._vel_ned_mps, *5 * (0.0,)
        )
        yield Send("autopilot", MavlinkCodec(1, 1).pack(message))


class Inbox:
    """Setpoints of the goal in charge, and no request."""

    def __init__(self, *setpoints: Setpoint) -> None:
        self._setpoints = setpoints

    def new(self, topic: Topic[Any]) -> tuple[Setpoint, ...]:
        return self._setpoints

    def requests(self, endpoint: Any) -> tuple[Any, ...]:
        return ()


def fence_to(north_m: float) -> Fence:
    """A fence whose northern edge is so far from the origin."""
    corners_ned_m = ((-60.0, -60.0), (north_m, -60.0), (north_m, 60.0), (-60.0, 60.0))
    return Fence(keep_in=Zone(name="field", corners_ned_m=corners_ned_m))


def is_excused(here_ned_m: Vec3, asked_ned_m: Vec3, sent_ned_m: Vec3) -> bool:
    """Whether a target may be sent, for a vehicle at a place whose goal asks for a point."""
    judge = Judge()
    bridge = BridgeJudge(FakeBridge(here_ned_m, sent_ned_m), judge, {}, LIMITS)
    inbox: Any = Inbox(Setpoint(t_ns=10 * S, control_id="c", sequence=1, phase=Phase.GO_TO, pos_ned_m=asked_ned_m))
    list(bridge.step(10 * S, inbox))
    return not any(violation.rule == RULE for violation in judge.violations)


@pytest.mark.parametrize(
    ("here_ned_m", "asked_ned_m", "sent_ned_m", "excused"),
    [
        ((0.0, 0.0, -5.0), (1.0, 0.0, -5.0), (1.0, 0.0, -5.0), True),
        ((0.0, 0.0, -5.0), (1.0, 0.0, -5.0), (2.0, 0.0, -5.0), False),
        ((0.0, 0.0, -5.0), (1.0, 0.0, -5.0), (433.0, 0.0, -227.0), False),
        ((0.0, 0.0, -121.8), (0.0, 0.0, -122.4), (0.0, 0.0, -122.0), True),
        ((499.8, 0.0, -5.0), (503.0, 0.0, -5.0), (502.0, 0.0, -5.0), True),
    ],
)
def test_only_what_is_asked_for_or_what_the_limits_ask_for_is_sent(
    here_ned_m: Vec3, asked_ned_m: Vec3, sent_ned_m: Vec3, excused: bool
) -> None:
    assert is_excused(here_ned_m, asked_ned_m, sent_ned_m) is excused


@pytest.mark.parametrize(("fence", "excused"), [(None, False), (fence_to(5.0), True), (fence_to(50.0), False)])
def test_a_vehicle_whose_goal_is_late_hovers_unless_a_fence_leads_it_back_inside(
    fence: Fence | None, excused: bool
) -> None:
    judge, here_ned_m, back_ned_mps = Judge(), (5.5, 0.0, -5.0), (-1.0, 0.0, 0.0)
    bridge = BridgeJudge(FakeBridge(here_ned_m, here_ned_m, back_ned_mps, fence), judge, {}, LIMITS)
    setpoint = Setpoint(t_ns=10 * S, control_id="c", sequence=1, phase=Phase.GO_TO, pos_ned_m=here_ned_m)
    inboxes: tuple[tuple[int, Any], ...] = ((10 * S, Inbox(setpoint)), (10 * S + 620 * S // 1000, Inbox()))
    for t_ns, inbox in inboxes:
        list(bridge.step(t_ns, inbox))
    assert any(violation.rule == "a late goal hovers" for violation in judge.violations) is not excused
