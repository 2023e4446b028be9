"""What the campaign draws besides goals and faults: fences and missions."""

from math import hypot

import msgspec
from shapely import Point, Polygon

from jezero.plugins import all_actions
from jezero.schemas.mission import GoalStep
from jezero.services.mission.step_run import goal_of
from jezero.trials.campaign.fences import draw_fence
from jezero.trials.campaign.mission import Mission, named_random
from jezero.trials.campaign.missions import draw_mission
from jezero.trials.campaign.worlds import POINT_MASS


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


def test_every_step_of_a_drawn_mission_is_a_goal_of_its_action() -> None:
    kinds = set()
    for seed in range(200):
        mission = draw_mission(named_random(seed, "mission"), 5, from_ground=True)
        assert msgspec.convert(msgspec.to_builtins(mission), type(mission)) == mission
        for step in mission.steps:
            kinds.add(step.action if isinstance(step, GoalStep) else "wait")
            if isinstance(step, GoalStep):
                goal_of(all_actions()[step.action], step.goal, "g", 5)
    assert kinds == {*all_actions(), "wait"}


def test_some_seeds_fly_missions_with_the_service_that_flies_them_and_others_single_goals() -> None:
    flown = [Mission(seed, world=POINT_MASS) for seed in range(12)]
    missions = [mission for mission in flown if mission.missions is not None]
    assert 0 < len(missions) < len(flown)
    for mission in flown:
        assert bool(mission.clients) is (mission.missions is None)
        assert mission.bus.has("mission") is (mission.missions is not None)
