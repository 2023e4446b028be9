"""Goals with the worst numbers and shapes: each action refuses them with a sentence, raises nothing, and goes on."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from jezero.schemas import topics
from jezero.schemas.actions import Accepted, PlanReply, Rejected
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, Goal, GoToGoal, LandOnSpotGoal, TakeoffGoal
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.rig import World

SQUARE = ((0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0))
NUMBERS = (-1e300, -1e6, -1.0, -1e-300, 0.0, 1e-300, 1e-9, 1e6, 1e300)
COUNTS = (-(10**12), -1, 0, 1, 256, 10**12)
GOALS: dict[str, Goal] = {
    "takeoff": TakeoffGoal(altitude_m=2.0),
    "go_to": GoToGoal(target_ned_m=(3.0, 0.0, -3.0), yaw_rad=0.5, speed_mps=1.0),
    "get_images": GetImagesGoal(center_ned_m=(5.0, 0.0, -3.0), radius_m=3.0, num_images=4, speed_mps=1.0),
    "area_coverage": AreaCoverageGoal(
        polygon_ned_m=SQUARE, z_ned_m=-4.0, resolution_m=2.0, speed_mps=1.0, start_ned_m=(0.0, 0.0), first_picture=1
    ),
    "land_on_spot": LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(2.0, 0.0, 0.0)),
}
"""A good goal of each action, with a value in every field that has numbers."""


def nasty_goals(name: str) -> Iterator[Goal]:
    """The good goal with one field that is nasty, for every field and value."""
    goal = GOALS[name]
    for field in goal.__struct_fields__:
        value = getattr(goal, field)
        if isinstance(value, bool | str) or value is None or field == "polygon_ned_m":
            continue
        if isinstance(value, int):
            yield from (msgspec.structs.replace(goal, **{field: count}) for count in COUNTS)
        elif isinstance(value, float):
            yield from (msgspec.structs.replace(goal, **{field: number}) for number in NUMBERS)
        elif isinstance(value, tuple) and value:
            for number in NUMBERS:
                yield msgspec.structs.replace(goal, **{field: (number,) * len(value)})
                yield msgspec.structs.replace(goal, **{field: (*value[:-1], number)})


SHAPES: dict[str, dict[str, Any]] = {
    "no corners": {"polygon_ned_m": ()},
    "one corner": {"polygon_ned_m": ((0.0, 0.0),)},
    "the same corner only": {"polygon_ned_m": ((1.0, 1.0),) * 9},
    "corners on a line": {"polygon_ned_m": ((0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (3.0, 3.0))},
    "a spike": {"polygon_ned_m": ((0.0, 0.0), (6.0, 0.0), (20.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0))},
    "a corner twice": {"polygon_ned_m": (*SQUARE[:2], *SQUARE[1:])},
    "corners a millimetre apart": {"polygon_ned_m": (*SQUARE, (0.001, 6.0), (0.0, 5.999))},
    "edges that cross": {"polygon_ned_m": ((0.0, 0.0), (6.0, 6.0), (6.0, 0.0), (0.0, 6.0))},
    "two loops": {
        "polygon_ned_m": ((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (6.0, 3.0), (6.0, 6.0), (3.0, 6.0), (3.0, 3.0))
    },
    "a nanometre": {"polygon_ned_m": ((0.0, 0.0), (1e-9, 0.0), (1e-9, 1e-9))},
    "a thousand kilometres": {"polygon_ned_m": ((0.0, 0.0), (1e6, 0.0), (1e6, 1e6))},
    "far away": {"polygon_ned_m": tuple((north + 9e5, east) for north, east in SQUARE)},
    "a hole equal to the outline": {"holes_ned_m": (SQUARE,)},
    "a hole equal to the outline, turned": {"holes_ned_m": (tuple(reversed(SQUARE)),)},
    "a hole that leaves a hair": {
        "holes_ned_m": (((1e-6, 1e-6), (5.999999, 1e-6), (5.999999, 5.999999), (1e-6, 5.999999)),)
    },
    "a hole around the outline": {"holes_ned_m": (((-1.0, -1.0), (9.0, -1.0), (9.0, 9.0), (-1.0, 9.0)),)},
    "a hole outside": {"holes_ned_m": (((20.0, 20.0), (21.0, 20.0), (21.0, 21.0)),)},
    "a hole that cuts the area in two": {"holes_ned_m": (((2.0, 0.0), (4.0, 0.0), (4.0, 6.0), (2.0, 6.0)),)},
    "a hole twice": {"holes_ned_m": (((2.0, 2.0), (3.0, 2.0), (3.0, 3.0)),) * 2},
    "a hole with one corner": {"holes_ned_m": (((2.0, 2.0),),)},
    "an empty hole": {"holes_ned_m": ((),)},
}


@pytest.fixture
def world() -> World:
    made = World()
    made.bus.add(FakeCamera())
    made.bus.run_for(0.3)
    return made


def plan_reply(world: World, name: str, goal: Goal) -> PlanReply:
    request = world.bus.send_request(topics.ACTIONS[name].plan, goal, "me")
    assert world.bus.run_for(30.0, lambda: request.ended), goal
    (reply,) = request.replies
    assert isinstance(reply, PlanReply)
    return reply


def check(world: World, name: str, goal: Goal, errors: Any) -> None:
    """The goal has a plan or a refusal with a reason, and nothing was raised."""
    reply = plan_reply(world, name, goal)
    printed = errors.readouterr().err
    assert reply.accepted or reply.reason, goal
    assert "failed in" not in reply.reason, (goal, reply.reason)
    assert "Traceback" not in printed, (goal, printed)


@pytest.mark.parametrize("name", GOALS)
def test_no_number_makes_an_action_raise(world: World, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for goal in nasty_goals(name):
        check(world, name, goal, capsys)
    usual = msgspec.structs.replace(GOALS[name], first_picture=0) if name == "area_coverage" else GOALS[name]
    if name != "takeoff":  # the vehicle flies already
        assert plan_reply(world, name, usual).accepted


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("frame", ["world", "rover"])
def test_no_shape_makes_a_coverage_raise(
    world: World, shape: dict[str, Any], frame: str, capsys: pytest.CaptureFixture[str]
) -> None:
    goal = AreaCoverageGoal(**{"polygon_ned_m": SQUARE, "z_ned_m": -4.0, "resolution_m": 2.0, **shape})
    check(world, "area_coverage", msgspec.structs.replace(goal, frame=frame), capsys)


def test_after_all_that_the_same_servers_fly_goals(world: World) -> None:
    bad = AreaCoverageGoal(polygon_ned_m=SQUARE, holes_ned_m=(SQUARE,), z_ned_m=-4.0, resolution_m=2.0)
    assert isinstance(world.fly(bad), Rejected)
    good = msgspec.structs.replace(bad, holes_ned_m=())
    answers = world.send(good)
    assert world.bus.run_for(5.0, lambda: bool(answers.replies))
    assert isinstance(answers.replies[0], Accepted)
