"""Fences that are drawn, and the rules of fences, which find what breaks them and excuse what no bridge can prevent."""

from dataclasses import dataclass, field
from math import hypot
from typing import Any

import pytest
from shapely import Point, Polygon

from jezero.base.codec import encode
from jezero.base.frames import Vec3
from jezero.runtime.memory_bus import SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Rejected
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.goals import GoToGoal
from jezero.schemas.state import Odometry, Status, StatusCode, Truth
from jezero.trials.campaign.clients import SentGoal
from jezero.trials.campaign.fence import RULE, FenceJudge, FenceShape, draw_fence
from jezero.trials.campaign.judge import Judge
from jezero.trials.campaign.judge_actions import GoalRecord
from jezero.trials.campaign.mission import named_random

S = 1_000_000_000
STEP_NS = S // 10
STILL = (0.0, 0.0, 0.0)
AT_REST: dict[str, Any] = {
    "epoch_id": 1,
    "vel_uav_ned_mps": STILL,
    "q_ned_from_frd": (1.0, 0.0, 0.0, 0.0),
    "rates_uav_frd_rps": STILL,
}
FIELD = Zone(name="field", corners_ned_m=((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)))
CRATER = Zone(name="crater", corners_ned_m=((4.0, -2.0), (8.0, -2.0), (8.0, 2.0), (4.0, 2.0)))
FENCE = Fence(keep_in=FIELD, keep_out=(CRATER,), ceiling_m=6.0)


@dataclass
class Flown:
    """A vehicle in flight, whose places the judge observes ten times a second."""

    code: StatusCode = StatusCode.HOVER
    t_ns: int = 10 * S
    judge: Judge = field(default_factory=Judge)

    def __post_init__(self) -> None:
        self.observer = FenceJudge(self.judge)
        self.observer(self.t_ns, topics.FENCE.name, encode(FenceState(t_ns=self.t_ns, fence=FENCE, fence_id="f")))
        self.at(STILL, seconds=6.0)

    def at(self, pos_ned_m: Vec3, error_ned_m: Vec3 = STILL, seconds: float = 0.1) -> None:
        """Stay at a place by the estimate, which is wrong by an error."""
        for _ in range(round(seconds * 10)):
            self.t_ns += STEP_NS
            north_m, east_m, down_m = (p - e for p, e in zip(pos_ned_m, error_ned_m, strict=True))
            self.observer(self.t_ns, topics.TRUTH.name, encode(truth(self.t_ns, (north_m, east_m, down_m))))
            self.observer(self.t_ns, topics.STATUS.name, encode(status(self.t_ns, self.code)))
            self.observer(self.t_ns, topics.ODOMETRY.name, encode(odometry(self.t_ns, pos_ned_m)))

    @property
    def broken(self) -> bool:
        return any(violation.rule == RULE for violation in self.judge.violations)


def truth(t_ns: int, pos_ned_m: Vec3) -> Truth:
    return Truth(
        t_ns=t_ns,
        pos_uav_ned_m=pos_ned_m,
        pos_rover_ned_m=STILL,
        vel_rover_ned_mps=STILL,
        yaw_rover_rad=0.0,
        wind_ned_mps=STILL,
        contact_force_n=0.0,
        armed_motors=True,
        **AT_REST,
    )


def status(t_ns: int, code: StatusCode) -> Status:
    return Status(
        t_ns=t_ns,
        code=code,
        name=code.name,
        armed=code is not StatusCode.IDLE,
        landed=code is StatusCode.IDLE,
        in_charge="hover",
        bridge_boot_id=1,
        ready=True,
    )


def odometry(t_ns: int, pos_ned_m: Vec3) -> Odometry:
    return Odometry(t_ns=t_ns, pos_uav_ned_m=pos_ned_m, **AT_REST)


@pytest.mark.parametrize(
    ("pos_ned_m", "broken"),
    [
        ((9.9, 0.0, -3.0), False),
        ((10.29, 0.0, -3.0), False),
        ((10.31, 0.0, -3.0), True),
        ((0.0, -10.4, -3.0), True),
        ((4.25, 0.0, -3.0), False),
        ((6.0, 1.6, -3.0), True),
        ((0.0, 0.0, -6.25), False),
        ((0.0, 0.0, -6.35), True),
    ],
)
def test_the_vehicle_is_never_farther_beyond_the_fence_than_the_bound(pos_ned_m: Vec3, broken: bool) -> None:
    flown = Flown()
    flown.at(pos_ned_m)
    assert flown.broken is broken


def test_an_estimate_that_moves_by_itself_excuses_as_much_as_it_moved() -> None:
    flown = Flown()
    flown.at((12.0, 0.0, -3.0), error_ned_m=(3.0, 0.0, 0.0))
    flown.at((13.2, 0.0, -3.0), error_ned_m=(3.0, 0.0, 0.0))
    assert not flown.broken
    flown.at((13.4, 0.0, -3.0), error_ned_m=(3.0, 0.0, 0.0))
    assert flown.broken


def test_a_constant_error_and_small_motions_of_the_estimate_excuse_nothing() -> None:
    flown = Flown()
    flown.at(STILL, error_ned_m=(3.0, 0.0, 0.0), seconds=6.0)
    flown.at((10.4, 0.0, -3.0), error_ned_m=(3.3, 0.0, 0.0))
    assert flown.broken


def test_a_vehicle_that_somebody_else_flies_is_judged_again_when_it_is_inside() -> None:
    flown = Flown(code=StatusCode.EXTERNAL)
    flown.at((15.0, 0.0, -3.0), seconds=4.0)
    flown.code = StatusCode.HOVER
    flown.at((15.0, 0.0, -3.0), seconds=4.0)
    assert not flown.broken
    flown.at((9.0, 0.0, -3.0))
    flown.at((10.5, 0.0, -3.0))
    assert flown.broken


def test_a_bridge_without_news_is_not_blamed_for_some_seconds() -> None:
    flown = Flown()
    flown.t_ns += S // 2
    flown.at((11.0, 0.0, -3.0), seconds=2.0)
    assert not flown.broken
    flown.at((9.0, 0.0, -3.0), seconds=2.0)
    flown.at((11.0, 0.0, -3.0))
    assert flown.broken


def test_an_autopilot_without_setpoints_is_not_blamed_on_the_bridge() -> None:
    flown = Flown()
    flown.observer.on_gap(flown.t_ns)
    flown.at((11.0, 0.0, -3.0), seconds=2.0)
    assert not flown.broken


def test_the_fence_changes_on_the_ground_only() -> None:
    flown = Flown()
    flown.observer(flown.t_ns, topics.FENCE.name, encode(FenceState(t_ns=flown.t_ns)))
    assert [violation.rule for violation in flown.judge.violations] == ["the fence changes on the ground only"]


def test_no_goal_ends_outside_the_fence_that_the_servers_know() -> None:
    flown = Flown()
    outside = GoToGoal(goal_id="g", target_ned_m=(6.0, 0.0, -3.0))
    early = GoalRecord("g", "go_to", 1, accepted_ns=12 * S)
    flown.observer.judge_goals([early], {"g": outside})
    assert flown.judge.violations == []
    flown.observer.judge_goals([GoalRecord("g", "go_to", 1, accepted_ns=16 * S)], {"g": outside})
    assert [violation.rule for violation in flown.judge.violations] == ["no goal ends outside the fence"]


@pytest.mark.parametrize(
    ("reason", "broken"),
    [
        ("the way leaves the fence 'fence': 1.0 m inside the zone 'crater' to stay out of", False),
        ("the way leaves the fence 'fence': 0.5 m above the ceiling of 6 m", False),
        ("the way leaves the fence 'fence'", True),
        ("the battery is empty", False),
    ],
)
def test_a_refusal_by_the_fence_names_the_zone(reason: str, broken: bool) -> None:
    flown = Flown()
    goal = SentGoal(GoToGoal(goal_id="g", target_ned_m=STILL), topics.GO_TO)
    goal.queries.append(SentRequest(replies=[Rejected(goal_id="g", reason=reason)]))
    flown.observer.judge_refusals({"g": goal})
    assert bool(flown.judge.violations) is broken


def test_the_shape_is_negative_inside_by_the_distance_to_the_nearest_edge() -> None:
    shape = FenceShape(FENCE)
    assert shape.beyond_m((0.0, 0.0, -1.0)) == pytest.approx(-4.0)
    assert shape.beyond_m((0.0, 8.0, -5.5)) == pytest.approx(-0.5)
    assert shape.beyond_m((20.0, 0.0, -1.0)) == pytest.approx(10.0)


def test_a_drawn_fence_is_valid_and_the_vehicle_first_stands_inside() -> None:
    for seed in range(200):
        fence = draw_fence(named_random(seed, "fence"))
        zones = [Polygon(zone.corners_ned_m) for zone in fence.zones]
        assert all(zone.is_valid for zone in zones)
        assert all(
            zone.contains(Point(0.0, 0.0)) is (each is fence.keep_in)
            for zone, each in zip(zones, fence.zones, strict=True)
        )
        assert all(hypot(*corner) < 16.0 for each in fence.zones for corner in each.corners_ned_m)


def test_ceilings_floors_and_zones_of_both_kinds_are_drawn_and_left_out() -> None:
    fences = [draw_fence(named_random(seed, "fence")) for seed in range(200)]
    assert {fence.ceiling_m is None for fence in fences} == {True, False}
    assert {fence.floor_over_ground_m == 0.0 for fence in fences} == {True, False}
    assert {len(fence.keep_out) for fence in fences} == {0, 1, 2}
    assert {fence.keep_in is None for fence in fences} == {True, False}
