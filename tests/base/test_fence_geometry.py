"""Distances to a fence, and ways that leave it."""

from itertools import pairwise
from math import cos, dist, isclose, pi, sin
from random import Random

import pytest
import shapely

from jezero.base.fence import (
    HOLD_OFF_M,
    edges,
    nearest,
    outside_reason,
    place_refusal,
    placed,
    point_inside,
    way_refusal,
)
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


def test_only_the_first_leg_of_a_takeoff_and_the_last_of_a_landing_may_be_below_the_floor() -> None:
    high, low, ground = (0.0, 0.0, -3.0), (0.0, 5.0, -0.6), (0.0, 0.0, 0.0)
    for way, from_ground, to_ground in (
        ([ground, high, low], True, False),
        ([ground, low, high], False, True),
        ([low, high, ground], False, True),
        ([high, ground, low], True, False),
    ):
        refusal = way_refusal(FENCE, way, from_ground=from_ground, to_ground=to_ground)
        assert refusal.startswith("the way leaves the fence") and "below the floor of 1 m" in refusal
    assert way_refusal(FENCE, [ground, high, low, ground], from_ground=True, to_ground=True) != ""
    assert way_refusal(FENCE, [ground, high, ground], from_ground=True, to_ground=True) == ""


@pytest.mark.parametrize("length_m", [0.05, 0.12, 0.18, 0.35])
def test_a_way_is_judged_however_short_it_is(length_m: float) -> None:
    """It ends 0.03 m too near to the edge, from which it must stay 0.5 m away."""
    end: Vec3 = (0.0, 9.53, -3.0)
    begin: Vec3 = (0.0, 9.53 - length_m, -3.0)
    refusal = way_refusal(FENCE, [begin, end], from_ground=False, to_ground=False)
    assert "within 0.5 m of the edge of the area 'field'" in refusal
    assert way_refusal(FENCE, [begin, (0.0, 9.47, -3.0)], from_ground=False, to_ground=False) == ""


def test_a_place_exactly_at_a_limit_is_within_it() -> None:
    for place in ((0.0, 9.5, -3.0), (3.5, 0.0, -3.0), (0.0, 0.0, -19.5), (0.0, 0.0, -1.0)):
        assert place_refusal(FENCE, place, low_allowed=False) == ""
    for place in ((0.0, 9.51, -3.0), (3.51, 0.0, -3.0), (0.0, 0.0, -19.51), (0.0, 0.0, -0.99)):
        assert place_refusal(FENCE, place, low_allowed=False) != ""


def test_a_zone_with_the_same_corner_twice_is_measured_as_without() -> None:
    corners_m = SQUARE.corners_ned_m
    for index in range(4):
        twice = (*corners_m[: index + 1], *corners_m[index:])
        fence = Fence(keep_in=Zone(name="field", corners_ned_m=twice))
        for point_m, inside in (((0.0, 9.0), 1.0), ((-12.0, -10.0), -2.0), ((13.0, 14.0), -5.0)):
            at = nearest(fence, point_m)
            assert at is not None and isclose(at.inside_m, inside, abs_tol=1e-9)


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
        ((0.0, 10.0, -15.0), (0.0, 9.0, -15.0)),  # on the edge, from which no direction leads away
        ((-5.0, -10.0, -15.0), (-5.0, -9.0, -15.0)),
    ],
)
def test_the_way_back_ends_a_metre_inside(outside: Vec3, expected: Vec3) -> None:
    assert point_inside(FENCE, outside, 1.0) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("direction_deg", range(0, 180, 5))
def test_from_any_edge_the_way_back_is_straight_away_from_it(direction_deg: int) -> None:
    """The edge of a square of 40 m whose middle is the origin, turned by an angle."""
    c, s = cos(direction_deg * pi / 180.0), sin(direction_deg * pi / 180.0)
    corners_m = tuple((20.0 * (a * c - b * s), 20.0 * (a * s + b * c)) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    fence = Fence(keep_in=Zone(name="field", corners_ned_m=corners_m))
    edge, inside = (20.0 * c, 20.0 * s, -5.0), (19.0 * c, 19.0 * s, -5.0)
    assert point_inside(fence, edge, 1.0) == pytest.approx(inside, abs=0.01)


def star(rng: Random, name: str, middle_m: tuple[float, float], radius_m: float) -> Zone:
    """A polygon with corners in all directions around its middle, in either order, that may have notches."""
    bearings = sorted(rng.uniform(0.0, 2.0 * pi) for _ in range(rng.randrange(5, 12)))
    radii_m = [radius_m * rng.uniform(0.3, 1.0) for _ in bearings]
    corners_m = [
        (middle_m[0] + r * cos(angle), middle_m[1] + r * sin(angle)) for r, angle in zip(radii_m, bearings, strict=True)
    ]
    return Zone(name=name, corners_ned_m=tuple(corners_m[:: rng.choice((1, -1))]))


def random_fence(rng: Random) -> Fence:
    out = tuple(star(rng, f"out {i}", (rng.uniform(-9.0, 9.0), rng.uniform(-9.0, 9.0)), 4.0) for i in range(2))
    return Fence(keep_in=star(rng, "in", (0.0, 0.0), 20.0), keep_out=out, ceiling_m=20.0, floor_over_ground_m=1.0)


def inside_m(zone: Zone, point: shapely.Point, keep_in: bool) -> float:
    """Distance to the zone's outline, negative where the zone is violated."""
    shape = shapely.Polygon(zone.corners_ned_m)
    return float(shape.exterior.distance(point)) * (1.0 if shape.contains(point) is keep_in else -1.0)


@pytest.mark.parametrize("seed", range(20))
def test_distances_to_any_zone_are_those_of_shapely(seed: int) -> None:
    rng = Random(seed)
    fence = random_fence(rng)
    for _ in range(40):
        point_m = (rng.uniform(-22.0, 22.0), rng.uniform(-22.0, 22.0))
        point = shapely.Point(point_m)
        distances_m = {zone.name: inside_m(zone, point, zone is fence.keep_in) for zone in fence.zones}
        at, worst_m = nearest(fence, point_m), min(distances_m.values())
        assert at is not None and at.keep_in == (at.zone is fence.keep_in)
        assert at.inside_m == pytest.approx(worst_m, abs=1e-9)
        assert distances_m[at.zone.name] == pytest.approx(worst_m, abs=1e-9)
        assert dist(at.nearest_m, point_m) == pytest.approx(abs(worst_m), abs=1e-9)
        assert shapely.LineString((at.begin_m, at.end_m)).distance(shapely.Point(at.nearest_m)) < 1e-9

        found = list(edges(fence, point_m, 5.0))
        end_m = (rng.uniform(-22.0, 22.0), rng.uniform(-22.0, 22.0))
        for edge in found:
            line, way = shapely.LineString((edge.begin_m, edge.end_m)), shapely.LineString((point_m, end_m))
            side = 1.0 if distances_m[edge.zone.name] > 0.0 else -1.0
            assert edge.inside_m == pytest.approx(side * line.distance(point), abs=1e-9)
            assert edge.distance_to_way_m(point_m, end_m) == pytest.approx(line.distance(way), abs=1e-9)
        for zone in fence.zones:
            ring = [*zone.corners_ned_m, zone.corners_ned_m[0]]
            near = sum(shapely.LineString(each).distance(point) <= 5.0 for each in pairwise(ring))
            assert sum(edge.zone is zone for edge in found) == (near if distances_m[zone.name] > 0.0 else 1)

        up_m = rng.uniform(0.0, 22.0)
        place = (*point_m, -up_m)
        assert bool(outside_reason(fence, place, 0.7)) == (worst_m < 0.7 or up_m > 19.3)
        for low_allowed in (False, True):
            wrong = worst_m < HOLD_OFF_M or up_m > 20.0 - HOLD_OFF_M or (up_m < 1.0 and not low_allowed)
            assert bool(place_refusal(fence, place, low_allowed=low_allowed)) == wrong


@pytest.mark.parametrize("seed", range(20))
def test_a_way_is_refused_where_shapely_finds_it_outside_or_near_an_edge(seed: int) -> None:
    rng = Random(100 + seed)
    fence = random_fence(rng)
    assert fence.keep_in is not None
    free = shapely.Polygon(fence.keep_in.corners_ned_m).buffer(-HOLD_OFF_M)
    free = free.difference(
        shapely.unary_union([shapely.Polygon(z.corners_ned_m).buffer(HOLD_OFF_M) for z in fence.keep_out])
    )
    for _ in range(30):
        corners = [(rng.uniform(-9.0, 9.0), rng.uniform(-9.0, 9.0)) for _ in range(3)]
        way, line = [(*corner, -5.0) for corner in corners], shapely.LineString(corners)
        refusal = way_refusal(fence, way, from_ground=False, to_ground=False)
        if free.buffer(-0.05).contains(line):
            assert refusal == ""
        elif free.contains(shapely.Point(corners[0])) and line.difference(free.buffer(0.05)).length > 1.0:
            assert refusal.startswith("the way leaves the fence")


@pytest.mark.parametrize("seed", range(20))
def test_the_way_back_from_anywhere_leads_inside(seed: int) -> None:
    rng = Random(200 + seed)
    keep_in = star(rng, "in", (0.0, 0.0), 20.0)
    shape = shapely.Polygon(keep_in.corners_ned_m)
    fence = Fence(keep_in=keep_in, ceiling_m=20.0)
    for _ in range(20):
        outside = (rng.uniform(-40.0, 40.0), rng.uniform(-40.0, 40.0), -rng.uniform(0.0, 30.0))
        back = point_inside(fence, outside, 0.2)
        if not shape.buffer(-0.5).is_empty:
            assert shape.buffer(0.05).contains(shapely.Point(back[:2]))
        assert back[2] == max(outside[2], -19.8)
