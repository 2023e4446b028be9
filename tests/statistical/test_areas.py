"""Plans over random areas: no path leaves its area, and all of it is swept, or the area is refused with a reason."""

import pytest
import shapely
from shapely.geometry import Polygon

from jezero.base.frames import Vec3, geodetic_from_ned, ned_from_geodetic
from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import AreaError, Point
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.config import ActionsConfig
from tests.services.actions.area_coverage.random_areas import Corners, random_area

ORIGIN_DEG: Vec3 = (47.397742, 8.545594, 488.0)


def through_degrees(corners_m: Corners) -> tuple[Point, ...]:
    """The corners as they come back from a file in degrees with seven decimals, a centimetre."""
    corners: list[Point] = []
    for north_m, east_m in corners_m:
        latitude, longitude, _ = geodetic_from_ned((north_m, east_m, 0.0), ORIGIN_DEG)
        ned_m = ned_from_geodetic((round(latitude, 7), round(longitude, 7), ORIGIN_DEG[2]), ORIGIN_DEG)
        corners.append((ned_m[0], ned_m[1]))
    return tuple(corners)


def judge(seed: int) -> str:
    """Plan the area of a seed; returns why it was refused, or ""."""
    area = random_area(seed)
    outline, *holes = ((through_degrees(ring) if seed % 2 else tuple(ring)) for ring in (area.corners_m, *area.holes_m))
    goal = AreaCoverageGoal(
        polygon_ned_m=outline, holes_ned_m=tuple(holes), z_ned_m=-8.0, resolution_m=area.resolution_m, force=True
    )
    try:
        plan = plan_coverage(goal, ActionsConfig())
    except AreaError as error:
        return str(error)
    path = shapely.points(plan.trajectory.pos_m)
    ground = Polygon(outline).buffer(0.0)
    left_out = shapely.union_all([Polygon(hole).buffer(0.0) for hole in holes])
    assert float(shapely.distance(path, ground).max()) < 0.05
    assert left_out.is_empty or float(shapely.distance(path, left_out).min()) > goal.margin_holes_m
    assert plan.covered > 0.99
    return ""


@pytest.mark.parametrize("first", range(0, 40, 10))
def test_random_areas_are_swept_by_paths_that_stay_inside_or_refused_with_a_reason(first: int) -> None:
    refusals = [reason for seed in range(first, first + 10) if (reason := judge(seed))]
    assert len(refusals) <= 3
    assert all("parts" in reason for reason in refusals)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_of_five_hundred_random_areas_none_has_a_path_that_leaves_it() -> None:
    refusals = [reason for seed in range(500) if (reason := judge(seed))]
    assert len(refusals) <= 50
    assert all("parts" in reason for reason in refusals)
