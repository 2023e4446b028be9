"""Distances to a fence, and ways that leave it."""

from math import isclose

import pytest

from jezero.base.fence import nearest, outside_reason, placed, point_inside, way_refusal
from jezero.base.frames import Vec3
from jezero.schemas.fence import Fence, Zone

SQUARE = Zone(name="field", corners_ned_m=((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)))
CRATER = Zone(name="crater", corners_ned_m=((4.0, -2.0), (8.0, -2.0), (8.0, 2.0), (4.0, 2.0)))
FENCE = Fence(keep_in=SQUARE, keep_out=(CRATER,), ceiling_m=20.0, floor_over_ground_m=1.0)


@pytest.mark.parametrize(
    ("point_m", "inside_m", "zone"),
    [
        ((0.0, 0.0), 4.0, "crater"),
        ((0.0, 9.0), 1.0, "field"),
        ((13.0, 0.0), -3.0, "field"),
        ((13.0, 14.0), -5.0, "field"),
        ((6.0, 1.5), -0.5, "crater"),
        ((10.0, 5.0), 0.0, "field"),
    ],
)
def test_the_distance_is_that_to_the_nearest_outline_and_negative_outside(
    point_m: tuple[float, float], inside_m: float, zone: str
) -> None:
    at = nearest(FENCE, point_m)
    assert at is not None
    assert isclose(at.inside_m, inside_m, abs_tol=1e-9)
    assert at.zone.name == zone


@pytest.mark.parametrize(
    ("way", "expected"),
    [
        ([(0.0, 0.0, -3.0), (0.0, 8.0, -3.0)], ""),
        (
            [(0.0, 0.0, -3.0), (9.0, 0.0, -3.0)],
            "within 0.5 m of the edge of the zone 'crater' to stay out of, at north 3.",
        ),
        (
            [(0.0, 0.0, -3.0), (0.0, 20.0, -3.0)],
            "within 0.5 m of the edge of the area 'field' to stay in, at north 0.0 m, east 9.",
        ),
        ([(0.0, 0.0, -3.0), (0.0, 9.8, -3.0)], "within 0.5 m of the edge of the area 'field'"),
        ([(0.0, 0.0, -3.0), (0.0, 0.0, -25.0)], "within 0.5 m of the ceiling of 20 m"),
        ([(0.0, 0.0, -3.0), (0.0, 5.0, -0.6)], "is below the floor of 1 m"),
        ([(0.0, 15.0, -3.0), (0.0, 5.0, -3.0)], ""),
        ([(0.0, 15.0, -3.0), (0.0, 25.0, -3.0)], "the way is outside the fence"),
        ([(0.0, 15.0, -3.0), (0.0, -15.0, -3.0)], "the way leaves the fence"),
        ([], ""),
    ],
)
def test_a_way_that_leaves_the_fence_is_refused_with_the_place(way: list[Vec3], expected: str) -> None:
    refusal = way_refusal(FENCE, way, from_ground=False, to_ground=False)
    assert expected in refusal
    assert bool(refusal) == bool(expected)


def test_takeoff_and_landing_pass_the_floor() -> None:
    climb, land = [(0.0, 0.0, 0.0), (0.0, 0.0, -3.0)], [(0.0, 0.0, -3.0), (0.0, 0.0, 0.0)]
    assert not way_refusal(FENCE, climb, from_ground=True, to_ground=False)
    assert not way_refusal(FENCE, land, from_ground=False, to_ground=True)
    assert "floor" in way_refusal(FENCE, climb, from_ground=False, to_ground=False)


def test_zones_in_degrees_are_placed_around_the_origin() -> None:
    zone = Zone(name="z", corners_deg=((47.0, 8.0), (47.001, 8.0), (47.0, 8.001)))
    fence = Fence(keep_in=zone)
    assert placed(fence, None) is None
    placed_fence = placed(fence, (47.0, 8.0, 400.0))
    assert placed_fence is not None
    assert placed_fence.keep_in is not None
    corners_m = placed_fence.keep_in.corners_ned_m
    assert corners_m[0] == pytest.approx((0.0, 0.0), abs=1e-6)
    assert corners_m[1] == pytest.approx((111.19, 0.0), abs=0.1)
    assert not outside_reason(placed_fence, (20.0, 20.0, -2.0))
    assert outside_reason(placed_fence, (-1.0, 20.0, -2.0))


@pytest.mark.parametrize(
    ("outside", "expected"),
    [
        ((0.0, 10.7, -3.0), (0.0, 9.0, -3.0)),
        ((11.0, 11.0, -3.0), (9.0, 9.0, -3.0)),
        ((7.5, 0.0, -3.0), (9.0, 0.0, -3.0)),
        ((0.0, 0.0, -21.0), (0.0, 0.0, -19.0)),
        ((0.0, 0.0, -3.0), (0.0, 0.0, -3.0)),
    ],
)
def test_the_way_back_ends_a_metre_inside(outside: Vec3, expected: Vec3) -> None:
    assert point_inside(FENCE, outside, 1.0) == pytest.approx(expected, abs=0.01)
