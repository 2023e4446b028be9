"""A path that leaves its area is not flown, whatever planned it: planners and turns that make bad paths."""

from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
from shapely.geometry import Polygon, box

from jezero.base.arrays import Array
from jezero.schemas.actions import Rejected
from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage import coverage_plan
from jezero.services.actions.area_coverage.area import AreaError
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.area_coverage.path import distance_outside_m
from jezero.services.actions.config import ActionsConfig
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.rig import World

Path = Sequence[tuple[float, float]]
GOAL = AreaCoverageGoal(
    polygon_ned_m=((0.0, 0.0), (0.0, 20.0), (8.0, 20.0), (8.0, 8.0), (20.0, 8.0), (20.0, 0.0)),
    z_ned_m=-5.0,
    resolution_m=2.0,
    margin_holes_m=0.0,
)
HOLE = ((2.0, 10.0), (2.0, 12.0), (4.0, 12.0), (4.0, 10.0))


def planner_of(path_m: Path) -> Callable[..., Array]:
    """A planner that always plans this path."""
    return lambda *_: np.array(path_m, float)


def refusal(goal: AreaCoverageGoal = GOAL) -> str:
    with pytest.raises(AreaError) as error:
        plan_coverage(goal, ActionsConfig())
    return str(error.value)


def changed(**fields: Any) -> AreaCoverageGoal:
    return msgspec.structs.replace(GOAL, **fields)


@pytest.mark.parametrize(
    ("fields", "path_m", "outside"),
    [
        ({}, ((4.0, 18.0), (18.0, 4.0)), "3.00"),
        ({}, ((4.0, 4.0), (4.0, 23.5), (6.0, 23.5), (6.0, 4.0)), "3.50"),
        ({}, ((100.0, 100.0), (101.0, 100.0)), "122.58"),
        ({"holes_ned_m": (HOLE,)}, ((3.0, 4.0), (3.0, 18.0)), "1.00"),
        ({"holes_ned_m": (HOLE,), "margin_holes_m": 1.0}, ((4.8, 4.0), (4.8, 18.0)), "0.3"),
        ({"margin_outline_m": 2.0}, ((1.0, 4.0), (1.0, 10.0)), "1.1"),
    ],
    ids=[
        "across the corner of an L",
        "past the outline",
        "elsewhere",
        "through a hole",
        "too near to a hole",
        "too near to the outline",
    ],
)
def test_a_planner_that_leaves_the_area_is_refused_with_how_far(
    monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any], path_m: Path, outside: str
) -> None:
    monkeypatch.setattr(coverage_plan, "plan_path", planner_of(path_m))
    assert refusal(changed(**fields)).startswith(f"the path would leave the area or its margins by {outside}")


def test_turns_that_leave_the_area_are_refused_although_their_corners_are_inside(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A turn around the reflex corner at (8, 8) that begins 7 m before it leaves the L by more than a metre."""
    monkeypatch.setattr(coverage_plan, "plan_path", planner_of(((7.9, 19.0), (7.9, 7.9), (19.0, 7.9))))
    assert plan_coverage(changed(force=True), ActionsConfig()).trajectory.length_m > 20.0
    monkeypatch.setattr(coverage_plan, "turn_cuts", lambda path_m, *_: np.full(len(path_m), 7.0))
    assert "the path would leave the area or its margins by" in refusal(changed(force=True))


def test_a_goal_with_such_a_path_is_rejected_and_the_server_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    world.bus.add(FakeCamera())
    world.bus.run_for(0.3)
    with monkeypatch.context() as patched:
        patched.setattr(coverage_plan, "plan_path", planner_of(((4.0, 18.0), (18.0, 4.0))))
        reply = world.fly(changed(z_ned_m=-3.0))
    assert isinstance(reply, Rejected)
    assert "by 3.00 m, so it is not flown" in reply.reason
    assert world.fly(changed(z_ned_m=-3.0), 200.0).outcome == "succeeded"


@pytest.mark.parametrize(
    ("path_m", "outside_m"),
    [
        (((1.0, 1.0), (4.0, 4.0)), 0.0),
        (((0.0, 0.0), (5.0, 0.0)), 0.0),
        (((1.0, 1.0), (8.0, 1.0), (1.0, 1.0)), 3.0),
        (((9.0, 2.0), (9.0, 2.0)), 4.0),
        (((1.0, 1.0), (np.nan, 1.0)), np.inf),
        (((1.0, 1.0), (np.inf, 1.0)), np.inf),
    ],
    ids=["inside", "on the outline", "out and back", "standing outside", "not a number", "infinite"],
)
def test_how_far_a_path_leaves_its_area(path_m: Path, outside_m: float) -> None:
    area: Polygon = box(0.0, 0.0, 5.0, 5.0)
    assert distance_outside_m(np.array(path_m), area) == pytest.approx(outside_m)
