"""Goals that take pictures, changed while they are flown: no picture is lost or taken twice."""

from itertools import pairwise
from math import dist, hypot
from typing import Any

import pytest

from jezero.schemas import topics
from jezero.schemas.actions import Modify, ModifyReply
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, TakeoffGoal
from jezero.schemas.images import Image
from jezero.schemas.rows import Action
from jezero.schemas.struct import Payload
from jezero.trials.pauses import ObservedStack

ORBIT = GetImagesGoal(center_ned_m=(0.0, 0.0, -4.0), radius_m=3.0, num_images=8, goal_id="it")
FIELD = AreaCoverageGoal(
    polygon_ned_m=((-4.0, -3.0), (4.0, -3.0), (4.0, 3.0), (-4.0, 3.0)), z_ned_m=-5.0, resolution_m=1.5, goal_id="it"
)


class ModifiedFlight:
    """One goal that is changed after some of its pictures.

    Attributes:
        reply: to the change.
        result: of the goal.
        images: in its result.
    """

    def __init__(self, action: Action[Any], goal: Payload, after: int, **fields: Any) -> None:
        stack = ObservedStack(5, "point-mass")
        stack.wait_ready()
        up = stack.bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=4.0))
        assert stack.bus.run_for(30.0, lambda: up.ended)
        stack.bus.run_for(1.0)
        query = stack.bus.send_request(action.endpoint, goal)
        assert stack.bus.run_for(120.0, lambda: len(query.replies) > 1 and query.replies[-1].feedback.taken >= after), (
            query.replies[-1:]
        )
        self.reply: ModifyReply = stack.request(action.modify, Modify(goal_id="it", fields=fields))
        assert stack.bus.run_for(300.0, lambda: query.ended)
        self.result = query.replies[-1]
        self.images: tuple[Image, ...] = self.result.result.images
        self.greatest_step_mps = max(
            dist(one.vel_ned_mps, other.vel_ned_mps) - 2.0 * (other.t_ns - one.t_ns) / 1e9
            for one, other in pairwise(stack.setpoints)
            if one.vel_ned_mps and other.vel_ned_mps and other.t_ns - one.t_ns < 1e8
        )


@pytest.mark.parametrize(
    ("fields", "number"),
    [
        ({"speed_mps": 0.8, "num_images": 12}, 12),
        ({"num_images": 5}, 5),
        ({"radius_m": 2.0, "center_ned_m": [0.0, 0.0, -5.0]}, 8),
    ],
)
def test_an_orbit_goes_on_with_its_missing_pictures(fields: dict[str, Any], number: int) -> None:
    flight = ModifiedFlight(topics.GET_IMAGES, ORBIT, 3, **fields)
    assert flight.reply == ModifyReply(modified=True)
    assert flight.result.outcome == "succeeded"
    assert [image.index for image in flight.images] == list(range(number))
    radius_m, (_, _, z_ned_m) = fields.get("radius_m", 3.0), fields.get("center_ned_m", (0.0, 0.0, -4.0))
    for image in flight.images[-2:]:
        assert hypot(*image.pos_uav_ned_m[:2]) == pytest.approx(radius_m, abs=0.35)
        assert image.pos_uav_ned_m[2] == pytest.approx(z_ned_m, abs=0.35)


def test_an_orbit_can_not_take_fewer_pictures_than_it_has() -> None:
    flight = ModifiedFlight(topics.GET_IMAGES, ORBIT, 4, num_images=3)
    assert "4 pictures are taken already" in flight.reply.reason
    assert len(flight.images) == 8


def test_a_coverage_goes_on_along_its_path_at_another_speed_and_height() -> None:
    flight = ModifiedFlight(topics.AREA_COVERAGE, FIELD, 10, speed_mps=0.8, z_ned_m=-4.0)
    assert flight.reply == ModifyReply(modified=True)
    assert flight.result.outcome == "succeeded"
    assert [image.index for image in flight.images] == list(range(len(flight.images)))
    assert flight.result.result.photographed > 0.95
    assert flight.images[-1].pos_uav_ned_m[2] == pytest.approx(-4.0, abs=0.35)


def test_a_coverage_goes_on_with_the_area_that_remains() -> None:
    remaining = [[1.0, -3.0], [4.0, -3.0], [4.0, 3.0], [1.0, 3.0]]
    flight = ModifiedFlight(topics.AREA_COVERAGE, FIELD, 6, polygon_ned_m=remaining)
    assert flight.reply == ModifyReply(modified=True)
    assert flight.result.outcome == "succeeded"
    assert [image.index for image in flight.images] == list(range(len(flight.images)))
    assert flight.result.result.photographed > 0.95
    assert all(image.pos_uav_ned_m[0] > 0.5 for image in flight.images[9:])


def test_an_area_that_can_not_be_flown_is_refused_and_the_old_one_goes_on() -> None:
    crossed = [[0.0, 0.0], [600.0, 0.0], [600.0, 3.0]]
    flight = ModifiedFlight(topics.AREA_COVERAGE, FIELD, 4, polygon_ned_m=crossed)
    assert not flight.reply.modified
    assert "beyond the limit of 500 m" in flight.reply.reason
    assert flight.result.outcome == "succeeded"
    assert flight.result.result.photographed > 0.95
