"""Goals that the battery doesn't hold: numbers by hand, then goals of every action."""

import pytest

from jezero.base.vehicle_config import BatteryConfig
from jezero.schemas.actions import Rejected
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.state import Battery
from jezero.services.actions.lifecycle.protection import battery_refusal
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.lifecycle.test_server_plans import CIRCLE, FIELD, SPOT, plan
from tests.services.actions.rig import World

HALF_PERCENT_PER_S = BatteryConfig(capacity_mah=1000.0, electronics_a=3.0, hover_a=15.0)
"""18 A empty 1 Ah, which is 3600 A s, in 200 s."""


def battery(remaining: float | None, critical: float | None = 0.07) -> Battery:
    return Battery(voltage_v=15.0, remaining=remaining, critical=critical)


@pytest.mark.parametrize(
    ("flight_s", "landing_from_m", "remaining", "refused"),
    [
        (10.0, 0.0, 0.13, False),  # 12.5 % are sure, 5 % are used: 7.5 % are left
        (10.0, 0.0, 0.12, True),  # 11.5 % are sure: 6.5 % are left
        (10.0, 2.0, 0.23, False),  # the way home takes 20 s and 10 %: 7.5 % are left
        (10.0, 2.0, 0.22, True),
        (10.0, 10.0, 0.24, False),  # a landing from 10 m takes 10 / 0.5 + 2 = 22 s and 11 %: 7.5 % are left
        (10.0, 10.0, 0.23, True),
        (0.0, 0.0, 0.0, True),
    ],
)
def test_what_is_left_after_the_flight_must_reach_the_critical_level(
    flight_s: float, landing_from_m: float, remaining: float, refused: bool
) -> None:
    assert bool(battery_refusal(flight_s, landing_from_m, battery(remaining), HALF_PERCENT_PER_S)) is refused


def test_the_reason_has_the_numbers_and_what_to_do() -> None:
    assert battery_refusal(10.0, 2.0, battery(0.12), HALF_PERCENT_PER_S) == (
        "the battery is too low: 10 s of flight and 20 s for the way home after it use 15.0 %, only 11.5 % are sure to "
        "be there, and 7.0 % must be left for the autopilot's return: charge the battery, or fly a shorter way"
    )


@pytest.mark.parametrize("known", [None, battery(None), battery(0.01, critical=None)])
def test_a_battery_that_nobody_knows_refuses_nothing(known: Battery | None) -> None:
    assert battery_refusal(1e4, 100.0, known, HALF_PERCENT_PER_S) == ""


@pytest.mark.parametrize(
    ("start_z_m", "goal"),
    [
        (0.0, TakeoffGoal(altitude_m=2.0)),
        (0.0, GoToGoal(target_ned_m=(9.0, 3.0, -6.0), do_takeoff=True)),
        (-3.0, GoToGoal(target_ned_m=(300.0, 0.0, -3.0))),
        (-3.0, CIRCLE),
        (-3.0, FIELD),
    ],
    ids=["takeoff", "go_to after a takeoff", "go_to", "get_images", "area_coverage"],
)
def test_a_goal_below_its_reserve_is_refused_with_its_plan_and_flies_nothing(
    start_z_m: float, goal: TakeoffGoal | GoToGoal
) -> None:
    world = World((0.0, 0.0, start_z_m))
    world.bus.add(FakeCamera())
    world.bridge.battery = battery(0.075)
    world.bus.run_for(0.5)
    refused = world.fly(goal)
    assert isinstance(refused, Rejected)
    assert "the battery is too low" in refused.reason
    assert "7.0 % must be left" in refused.reason
    assert plan(world, goal).reason == refused.reason
    assert world.bridge.grants == 0


def test_a_full_battery_takes_off_and_the_plan_has_its_numbers() -> None:
    world = World((0.0, 0.0, 0.0))
    world.bridge.battery = battery(0.6)
    world.bus.run_for(0.5)
    planned = plan(world, TakeoffGoal(altitude_m=2.0))
    assert (planned.accepted, planned.battery_remaining, planned.battery_critical) == (True, 0.6, 0.07)
    world.flying(TakeoffGoal(altitude_m=2.0))


@pytest.mark.parametrize("goal", [SPOT, LandOnSpotGoal()], ids=["on a spot", "on the rover"])
def test_a_landing_is_never_refused_for_the_battery(goal: LandOnSpotGoal) -> None:
    world = World()
    world.bridge.battery = battery(0.03)
    world.bus.run_for(0.5)
    world.flying(goal)


def test_a_goal_that_is_sent_twice_at_once_and_refused_at_once_gets_two_replies() -> None:
    world = World()
    world.bridge.battery = battery(0.075)
    world.bus.run_for(0.3)
    goal = GoToGoal(target_ned_m=(300.0, 0.0, -3.0), goal_id="twice")
    sent = [world.send(goal) for _ in range(2)]
    world.bus.run_for(1.0)
    assert [request.ended for request in sent] == [True, True]
    for request in sent:
        (refused,) = request.replies
        assert isinstance(refused, Rejected)
        assert "the battery is too low" in refused.reason
    assert world.is_idle("go_to")
