"""Areas as people and programs draw them: repaired where their meaning is clear, else refused with what to change."""

from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Polygon

from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import CORNERS_MAX, AreaError, PlaceNames, Point, make_area, repair_area
from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan, plan_coverage
from jezero.services.actions.config import ActionsConfig

SQUARE: tuple[Point, ...] = ((0, 0), (0, 20), (20, 20), (20, 0))
L_SHAPE: tuple[Point, ...] = ((0, 0), (0, 20), (8, 20), (8, 8), (20, 8), (20, 0))


def plan(
    corners_m: Sequence[Point],
    holes_m: Sequence[Sequence[Point]] = (),
    *,
    resolution_m: float = 2.0,
    margin_outline_m: float = 0.0,
    margin_holes_m: float = 1.0,
    start_m: Point = (0.0, 0.0),
) -> CoveragePlan:
    """The plan over an area, 8 m up, where the camera sees more than the distance of two lines."""
    goal = AreaCoverageGoal(
        polygon_ned_m=tuple(corners_m),
        holes_ned_m=tuple(tuple(hole) for hole in holes_m),
        margin_outline_m=margin_outline_m,
        margin_holes_m=margin_holes_m,
        z_ned_m=-8.0,
        resolution_m=resolution_m,
    )
    return plan_coverage(goal, ActionsConfig(), start_m)


def outside_m(planned: CoveragePlan, area: Polygon) -> float:
    """Greatest distance of the flown path from an area."""
    flown = shapely.points(planned.trajectory.pos_m)
    return float(shapely.distance(flown, area).max())


def coast(corners: int, radius_m: float, seed: int) -> list[Point]:
    """An island whose outline is as rough as a coast."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    waves = np.arange(2, 200)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(waves))
    rough = (np.sin(np.outer(angles, waves) + phases) / waves**1.3).sum(axis=1)
    radii_m = radius_m * (1.0 + 0.25 * rough / np.abs(rough).max())
    return [(float(r * np.cos(a)), float(r * np.sin(a))) for r, a in zip(radii_m, angles, strict=True)]


def grid_of_holes(side: int, apart_m: float, size_m: float) -> list[list[Point]]:
    """Square holes in rows and columns around the origin."""
    first_m = -0.5 * apart_m * (side - 1) - 0.5 * size_m
    souths_wests = [(first_m + apart_m * i, first_m + apart_m * j) for i in range(side) for j in range(side)]
    return [[(n, e), (n, e + size_m), (n + size_m, e + size_m), (n + size_m, e)] for n, e in souths_wests]


@pytest.mark.parametrize(
    "corners_m",
    [
        [(0, 0), (0, 20), (8, 20), (8, 8), (8, 8), (20, 8), (20, 0)],
        [(0, 0), (0, 20), (8, 20), (8, 8.0004), (8.0003, 8), (20, 8), (20, 0)],
        [*L_SHAPE, L_SHAPE[0]],
        [*L_SHAPE, L_SHAPE[0], (0.0, 0.0003)],
        [corner for corner in L_SHAPE for _ in range(3)],
        [(0, 0), (0, 7), (0, 7.5), (0, 20), (8, 20), (8, 15), (8, 8), (20, 8), (20, 0), (3, 0), (1, 0)],
        list(reversed(L_SHAPE)),
    ],
    ids=["reflex corner twice", "a millimetre apart", "closed", "nearly closed", "thrice", "collinear", "reversed"],
)
def test_an_outline_with_needless_corners_gets_the_plan_of_the_same_outline_without_them(
    corners_m: list[Point],
) -> None:
    planned = plan(corners_m)
    assert outside_m(planned, Polygon(L_SHAPE)) < 0.01
    assert planned.trajectory.length_m == pytest.approx(plan(L_SHAPE).trajectory.length_m, rel=0.03)
    assert planned.covered > 0.99
    assert planned.warning == ""


def test_a_spike_is_left_out_with_a_warning_that_names_its_tip() -> None:
    planned = plan([(0, 0), (0, 20), (0, 26), (0, 20), (20, 20), (20, 0)])
    assert planned.warning == (
        "the polygon runs forth and back on one line, which is left out: at 0.00 m north, 26.00 m east"
    )
    assert outside_m(planned, Polygon(SQUARE)) < 0.01
    assert planned.covered > 0.99


def test_a_crossing_with_a_tiny_loop_is_repaired_with_a_warning_that_names_it() -> None:
    corners_m: list[Point] = [(0, 0), (0, 20), (10, 20.2), (10, 20), (9.9, 20.2), (20, 20), (20, 0)]
    planned = plan(corners_m)
    assert planned.warning == (
        "the polygon crosses or touches itself at 9.95 m north, 20.20 m east: 0.0099 m² there is left out"
    )
    assert outside_m(planned, Polygon(corners_m).buffer(0)) < 0.01
    assert planned.covered > 0.99


def test_an_outline_that_crosses_itself_is_refused_with_the_crossing_in_the_users_coordinates() -> None:
    with pytest.raises(AreaError, match=r"crosses or touches itself at 40\.00 m north, -20\.00 m east: give its"):
        plan([(30, -30), (50, -10), (50, -30), (30, -10)])


def test_places_of_an_area_in_degrees_are_named_in_degrees_too() -> None:
    places = PlaceNames((10.0, 0.0), (47.0, 8.0))
    with pytest.raises(
        AreaError, match=r"at latitude 47\.0001799, longitude 8\.0001319 \(20\.00 m north, 10\.00 m east\)"
    ):
        repair_area([(0, 0), (20, 20), (0, 20), (20, 0)], places=places)
    spiked = repair_area([(0, 0), (0, 20), (0, 26), (0, 20), (20, 20), (20, 0)], places=places)
    assert "at latitude 47.0000899, longitude 8.0003429 (10.00 m north, 26.00 m east)" in spiked.warnings[0]


def test_an_area_in_degrees_is_never_relative_to_the_rover() -> None:
    goal = AreaCoverageGoal(polygon_ned_m=SQUARE, origin_deg=(47.0, 8.0), frame="rover", z_ned_m=-8.0, resolution_m=2.0)
    with pytest.raises(AreaError, match="an area in degrees is in frame 'world' only"):
        plan_coverage(goal, ActionsConfig())


def test_a_hole_as_large_as_the_polygon_is_refused_as_nothing_is_left() -> None:
    with pytest.raises(AreaError, match="nothing is left to cover: the holes are as large as the polygon"):
        plan(SQUARE, [SQUARE])


def test_holes_that_cut_the_polygon_into_parts_are_refused_with_what_to_do() -> None:
    with pytest.raises(AreaError, match="the holes cut the polygon into 2 parts: map these one by one"):
        plan(SQUARE, [[(0, 9), (20, 9), (20, 11), (0, 11)]])


@pytest.mark.parametrize(
    "holes_m",
    [
        [[(0, 5), (6, 5), (6, 12), (0, 12)]],
        [[(5, 5), (5, 10), (10, 10), (10, 5)], [(10, 5), (10, 10), (15, 10), (15, 5)]],
        [[(5, 5), (5, 10), (10, 10), (10, 5)], [(10, 10), (10, 15), (15, 15), (15, 10)]],
        [[(5, 5), (5, 10), (10, 10), (10, 5)], [(7, 7), (7, 13), (13, 13), (13, 7)]],
        [[(5, 5), (5, 12), (12, 12), (12, 5)], [(6, 6), (6, 8), (8, 8), (8, 6)]],
        [[(5, 5), (5, 5), (5, 10), (5, 14), (5, 10), (10, 10), (10, 5)]],
    ],
    ids=["on the outline", "common edge", "common corner", "overlapping", "one in another", "spiked"],
)
@pytest.mark.parametrize("margin_m", [0.0, 1.0])
def test_holes_may_touch_the_outline_and_each_other(holes_m: list[list[Point]], margin_m: float) -> None:
    planned = plan(SQUARE, holes_m, margin_holes_m=margin_m)
    ground = Polygon(SQUARE).difference(shapely.union_all([Polygon(hole).buffer(0) for hole in holes_m]))
    assert outside_m(planned, ground) < 0.01
    away_m = shapely.union_all([Polygon(hole).buffer(0) for hole in holes_m]).distance(
        LineString(planned.trajectory.pos_m)
    )
    assert away_m >= margin_m - 0.01
    assert planned.covered > 0.985


def test_a_hole_that_is_partly_outside_is_refused() -> None:
    with pytest.raises(AreaError, match="hole 2 is not wholly inside the polygon"):
        plan(SQUARE, [[(5, 5), (5, 8), (8, 8), (8, 5)], [(15, 15), (15, 25), (18, 25), (18, 15)]])


def test_the_path_over_a_coast_of_three_thousand_corners_stays_inside() -> None:
    corners_m = coast(3000, 55.0, seed=1)
    planned = plan(corners_m, resolution_m=6.0)
    assert outside_m(planned, Polygon(corners_m)) < 0.05
    assert planned.covered > 0.99


def test_the_path_around_a_hundred_holes_enters_none() -> None:
    field_m: list[Point] = [(-60, -60), (-60, 60), (60, 60), (60, -60)]
    holes_m = grid_of_holes(10, 11.0, 3.0)
    planned = plan(field_m, holes_m, resolution_m=4.0)
    assert outside_m(planned, Polygon(field_m, holes_m)) == 0.0
    assert planned.covered > 0.99


def test_more_corners_than_can_be_planned_are_refused_with_what_to_do() -> None:
    with pytest.raises(AreaError, match=rf"corners, more than {CORNERS_MAX}: simplify it, or map it in parts"):
        make_area(coast(3 * CORNERS_MAX, 2000.0, seed=1))


def test_a_repair_keeps_all_that_it_does_not_name() -> None:
    repaired = repair_area([*L_SHAPE, L_SHAPE[0]], [[(2, 2), (2, 4), (4, 4), (4, 2)]])
    assert repaired.polygon.area == pytest.approx(Polygon(L_SHAPE).area - 4.0)
    assert repaired.outline.equals(Polygon(L_SHAPE))
    assert repaired.warnings == ()
