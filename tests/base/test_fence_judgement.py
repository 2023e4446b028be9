"""Fences that nobody can mean are refused in words, and doubtful ones are named."""

from collections.abc import Callable

import msgspec
import pytest
import shapely

from jezero.base.fence import JoinError, fence_doubts, fence_refusal, joined, placed, places_outside, zone_refusal
from jezero.base.frames import geodetic_from_ned
from jezero.schemas.fence import Fence, Zone

ORIGIN_DEG = (47.397742, 8.545594, 488.0)
Corners = tuple[tuple[float, float], ...]


def square(size_m: float, north_m: float = 0.0, east_m: float = 0.0) -> Corners:
    half_m = size_m / 2.0
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return tuple((north_m + half_m * north, east_m + half_m * east) for north, east in signs)


def metres(corners: Corners, name: str = "field") -> Zone:
    return Zone(name=name, corners_ned_m=corners)


def degrees(corners: Corners, name: str = "field") -> Zone:
    return Zone(name=name, corners_deg=tuple(geodetic_from_ned((*corner, 0.0), ORIGIN_DEG)[:2] for corner in corners))


@pytest.mark.parametrize("make", [metres, degrees])
@pytest.mark.parametrize(
    ("corners", "words"),
    [
        (((-10, -10), (10, 10), (10, -10), (-10, 10)), "its edges cross or touch at"),
        (((0, 0), (10, 0), (10, 10), (5, 0), (0, 10)), "its edges cross or touch at"),
        (((0, 0), (5, 0), (10, 0)), "it has no area: all its corners are in one line"),
        (((0, 0), (0, 5), (0, 10), (0, 2)), "it has no area"),
        (((0, 0), (0.1, 0), (0.1, 0.1)), "its corners are at most 141 mm apart"),
    ],
)
def test_a_zone_that_cannot_be_meant_is_refused(make: Callable[..., Zone], corners: Corners, words: str) -> None:
    zone = make(corners)
    assert zone_refusal(zone).startswith(words)
    for fence in (Fence(keep_in=zone), Fence(keep_out=(zone,))):
        assert words in fence_refusal(fence) and "'field'" in fence_refusal(fence)


@pytest.mark.parametrize(
    ("zone", "place"),
    [
        (metres(((-8, -9), (12, 11), (12, -9), (-8, 11))), "north 2.0 m, east 1.0 m"),
        (degrees(((-8, -9), (12, 11), (12, -9), (-8, 11))), "10.0 m north and 10.0 m east of its first corner, 47."),
    ],
)
def test_the_place_where_edges_cross_is_named(zone: Zone, place: str) -> None:
    assert f"its edges cross or touch at {place}" in zone_refusal(zone)


@pytest.mark.parametrize("make", [metres, degrees])
@pytest.mark.parametrize(("size_m", "taken"), [(0.6, False), (0.8, True)])
def test_a_zone_has_a_diagonal_of_at_least_a_metre(make: Callable[..., Zone], size_m: float, taken: bool) -> None:
    for corners in (square(size_m), square(size_m, 400.0, -300.0)):
        assert ("mm apart" in zone_refusal(make(corners))) is not taken


@pytest.mark.parametrize("make", [metres, degrees])
def test_zones_of_any_size_and_direction_are_taken(make: Callable[..., Zone]) -> None:
    for corners in (square(20.0), tuple(reversed(square(20.0))), square(20_000.0), ((0, 0), (9, 0), (0, 9), (3, 3))):
        assert zone_refusal(make(corners)) == ""


def test_degrees_that_are_written_as_metres_are_named() -> None:
    zone = metres(((47.3977, 8.5455), (47.3987, 8.5455), (47.3987, 8.5465)))
    assert "are they degrees? Then write `degrees: true`" in fence_refusal(Fence(keep_in=zone))


@pytest.mark.parametrize("make", [metres, degrees])
def test_an_area_in_which_nothing_is_left_to_fly_is_refused(make: Callable[..., Zone]) -> None:
    inside, hole = make(square(10.0)), make(square(18.0), "all")
    halves = [make(square(12.0, 0.0, east), f"half {east}") for east in (-5.0, 5.0)]
    assert "nothing is left to fly in: 'all' to stay out of" in fence_refusal(Fence(keep_in=inside, keep_out=(hole,)))
    assert "'half -5.0', 'half 5.0'" in fence_refusal(Fence(keep_in=inside, keep_out=tuple(halves)))
    assert fence_refusal(Fence(keep_in=inside, keep_out=(halves[0],))) == ""
    narrow = make(((0, 0), (50, 0), (50, 0.9), (0, 0.9)))
    assert "nowhere wider than 1 m" in fence_refusal(Fence(keep_in=narrow))


def test_zones_in_metres_and_degrees_are_compared_as_soon_as_the_origin_is_known() -> None:
    fence = Fence(keep_in=degrees(square(10.0)), keep_out=(metres(square(18.0), "all"),))
    assert fence_refusal(fence) == ""
    assert "nothing is left" in fence_refusal(fence, ORIGIN_DEG)


def test_exchanged_and_distant_degrees_are_named_where_the_origin_is_known() -> None:
    zone = degrees(square(100.0))
    exchanged = Zone(name="field", corners_deg=tuple((b, a) for a, b in zone.corners_deg))
    assert fence_refusal(Fence(keep_in=zone), ORIGIN_DEG) == ""
    for fence in (Fence(keep_in=exchanged), Fence(keep_in=zone, keep_out=(exchanged,))):
        assert "latitude and longitude are exchanged" in fence_refusal(fence, ORIGIN_DEG)
    assert "km from the vehicle's origin" in fence_refusal(Fence(keep_in=zone), (18.4446, 77.4509, 0.0))


@pytest.mark.parametrize(("north_m", "east_m"), [(60_000.0, 80_000.0), (100_000.0, 0.0), (0.0, -100_000.0)])
def test_a_zone_that_is_far_away_in_any_direction_is_refused_with_its_distance(north_m: float, east_m: float) -> None:
    zone = degrees(square(100.0, north_m, east_m))
    assert "it is 100 km from the vehicle's origin" in fence_refusal(Fence(keep_in=zone), ORIGIN_DEG)


def test_an_area_in_parts_is_taken_with_a_warning() -> None:
    wall = metres(((-1, -30), (1, -30), (1, 30), (-1, 30)), "wall")
    fence = Fence(keep_in=metres(square(20.0)), keep_out=(wall,))
    assert fence_refusal(fence) == ""
    (warning,) = fence_doubts(fence)
    assert "falls into 2 parts" in warning and "152 m², 152 m²" in warning
    assert fence_doubts(Fence(keep_in=metres(square(20.0)))) == fence_doubts(Fence(ceiling_m=5.0)) == ()


def test_vehicle_rover_and_the_way_between_them_are_looked_for() -> None:
    wall = metres(((-1, -5), (1, -5), (1, 5), (-1, 5)), "wall")
    fence = Fence(keep_in=metres(square(20.0)), keep_out=(wall,))
    assert places_outside(fence, (5.0, 0.0, 0.0), (5.0, 5.0, 0.0)) == ()
    assert places_outside(fence, (5.0, 0.0, 0.0), None) == ()
    vehicle, rover = places_outside(fence, (0.0, 0.0, 0.0), (15.0, 0.0, 0.0))
    assert vehicle.startswith("the vehicle is 1.0 m inside the zone 'wall'")
    assert rover.startswith("the rover is 5.0 m outside the area 'field'")
    (way,) = places_outside(fence, (5.0, 0.0, 0.0), (-5.0, 0.0, 0.0))
    assert way.startswith("from the vehicle to the rover the way leaves the fence")


def test_areas_on_both_sides_of_the_date_line_are_one() -> None:
    west = Zone(name="west", corners_deg=((0.0, 179.9), (0.0, -179.95), (0.1, -179.95), (0.1, 179.9)))
    east = Zone(name="east", corners_deg=((0.0, -179.97), (0.0, -179.8), (0.1, -179.8), (0.1, -179.97)))
    for zones in ([west, east], [east, west]):
        corners_deg = joined(zones).corners_deg
        assert {round(longitude_deg, 9) for _, longitude_deg in corners_deg} >= {179.9, -179.8}
        assert all(abs(longitude_deg) > 179.0 for _, longitude_deg in corners_deg)


def test_the_name_of_joined_areas_is_one_that_a_zone_may_have() -> None:
    west, east = metres(square(10.0, 0.0, -4.0), "w" * 40), metres(square(10.0, 0.0, 4.0), "e" * 40)
    assert msgspec.convert(msgspec.to_builtins(joined([west, east])), Zone).name == "w" * 40 + " and " + "e" * 19


@pytest.mark.parametrize("make", [metres, degrees])
def test_several_areas_that_touch_are_one(make: Callable[..., Zone]) -> None:
    west, east = make(square(10.0, 0.0, -4.0), "west"), make(square(10.0, 0.0, 4.0), "east")
    whole = joined([west, east])
    assert whole.name == "west and east"
    assert fence_refusal(Fence(keep_in=whole)) == ""
    assert joined([west]) is west
    placed_fence = placed(Fence(keep_in=whole), ORIGIN_DEG)
    assert placed_fence is not None and placed_fence.keep_in is not None
    assert shapely.Polygon(placed_fence.keep_in.corners_ned_m).area == pytest.approx(180.0, abs=0.1)
    far = make(square(10.0, 0.0, 40.0), "far")
    with pytest.raises(JoinError, match="don't touch"):
        joined([west, far])
    ring = [make(square(10.0, n, e), f"{n} {e}") for n in (-9.0, 0.0, 9.0) for e in (-9.0, 0.0, 9.0) if n or e]
    with pytest.raises(JoinError, match="surround a hole"):
        joined(ring)
    with pytest.raises(JoinError, match="in degrees and others in metres"):
        joined([metres(square(9.0)), degrees(square(9.0))])
    crossed = make(((-5, -5), (5, 5), (5, -5), (-5, 5)), "bow")
    for zones in ([west, crossed], [crossed, west]):
        with pytest.raises(JoinError, match="'bow': its edges cross or touch at"):
            joined(zones)
