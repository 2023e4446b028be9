"""Plans of area coverages: the thesis' polygon by its figures, random areas by what every plan must hold."""

from math import radians
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon

from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import AreaError, Point, make_area
from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan, plan_coverage
from jezero.services.actions.area_coverage.ground import CoveredGround
from jezero.services.actions.area_coverage.path import covered_fraction, plan_path
from jezero.services.actions.area_coverage.trajectory import Trajectory, make_trajectory, picture_distances
from jezero.services.actions.config import ActionsConfig

THESIS: tuple[Point, ...] = ((0, 0), (3, 5), (7, 4), (7, 2), (4, 1), (3, 2), (0, 0))
SQUARE: tuple[Point, ...] = ((0, 0), (4, 0), (4, 4), (0, 4))


def fly(area: Polygon, resolution_m: float, speed_mps: float = 1.0) -> Trajectory:
    path_m = plan_path(area, resolution_m)
    return make_trajectory(path_m, speed_mps=speed_mps, acceleration_mps2=1.0, cut_m=0.5 * resolution_m)


@pytest.mark.parametrize(("resolution_m", "ratio_max"), [(0.25, 1.15), (0.15, 1.12)])
def test_the_thesis_polygon_is_swept_with_a_short_path_and_a_picture_per_resolution(
    resolution_m: float, ratio_max: float
) -> None:
    area = make_area(THESIS)
    flown = fly(area, resolution_m)
    assert area.area == pytest.approx(16.5)
    assert covered_fraction(area, flown.pos_m, resolution_m) >= 0.995
    assert flown.length_m / (area.area / resolution_m) <= ratio_max
    assert len(picture_distances(flown.length_m, resolution_m)) == pytest.approx(
        flown.length_m / resolution_m, rel=0.01
    )


def random_area(rng: np.random.Generator, resolution_m: float) -> Polygon | None:
    """A star, a star with holes, or a crooked strip narrower than the resolution; None when it crosses itself."""

    def star(corners: int, radius_m: float, middle: tuple[float, float] = (0.0, 0.0)) -> list[Point]:
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
        radii_m = radius_m * rng.uniform(0.25, 1.0, corners)
        north_m, east_m = middle[0] + radii_m * np.cos(angles), middle[1] + radii_m * np.sin(angles)
        return [(float(n), float(e)) for n, e in zip(north_m, east_m, strict=True)]

    kind = int(rng.integers(3))
    try:
        if kind == 0:
            return make_area(star(int(rng.integers(4, 14)), rng.uniform(3.0, 10.0)))
        if kind == 1:
            outline = star(int(rng.integers(5, 12)), rng.uniform(6.0, 10.0))
            holes: list[list[Point]] = []
            for _ in range(int(rng.integers(1, 4))):
                north_m, east_m = rng.uniform(-4.0, 4.0, 2)
                hole = star(int(rng.integers(3, 7)), rng.uniform(0.5, 2.0), (north_m, east_m))
                if Polygon(hole).is_valid and Polygon(outline, holes).contains(Polygon(hole).buffer(0.05)):
                    holes.append(hole)
            return make_area(outline, holes)
        spine = LineString(np.cumsum(rng.uniform(-4.0, 4.0, (int(rng.integers(2, 5)), 2)), axis=0))
        width_m = rng.uniform(0.05, 0.8) * resolution_m
        strip = spine.buffer(0.5 * width_m, cap_style="flat", join_style="mitre")
        return make_area(list(strip.exterior.coords), [list(hole.coords) for hole in strip.interiors])
    except AreaError:
        return None


def random_areas(seed: int, count: int) -> list[tuple[Polygon, float]]:
    """Areas of one seed, each with its resolution in metres."""
    rng = np.random.default_rng(seed)
    areas: list[tuple[Polygon, float]] = []
    while len(areas) < count:
        resolution_m = float(rng.choice((0.25, 0.5, 1.0)))
        area = random_area(rng, resolution_m)
        if area is not None:
            areas.append((area, resolution_m))
    return areas


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_random_areas_are_swept_by_paths_that_stay_inside(seed: int, quarter: int) -> None:
    for area, resolution_m in random_areas(seed, 50)[quarter::4]:
        path_m = plan_path(area, resolution_m)
        assert covered_fraction(area, path_m, resolution_m) >= 0.99, area.wkt
        assert LineString(path_m).difference(area.buffer(1e-4)).length < 1e-6, area.wkt
        turned = make_trajectory(path_m, speed_mps=1.0, acceleration_mps2=1.0, cut_m=0.5 * resolution_m)
        assert covered_fraction(area, turned.pos_m, resolution_m) >= 0.985, area.wkt
        assert LineString(turned.pos_m).difference(area.buffer(0.1 * resolution_m)).length < 1e-6, area.wkt


def test_an_area_narrower_than_the_resolution_gets_a_pass_down_its_middle() -> None:
    path_m = plan_path(make_area(((0.0, 0.0), (6.0, 0.0), (6.0, 0.2), (0.0, 0.2))), 1.0)
    assert np.abs(path_m[:, 1] - 0.1).max() < 0.01
    assert np.ptp(path_m[:, 0]) > 5.0


def test_the_same_area_elsewhere_gets_the_same_plan() -> None:
    away = np.array((31.7, -12.3))

    def plan(by_m: NDArray[np.float64]) -> CoveragePlan:
        corners = tuple((float(north), float(east)) for north, east in np.array(THESIS) + by_m)
        goal = AreaCoverageGoal(polygon_ned_m=corners, z_ned_m=-5.0, resolution_m=0.25)
        return plan_coverage(goal, ActionsConfig(), (1.0 + by_m).tolist())

    here, there = plan(np.zeros(2)), plan(away)
    assert there.pictures_m - away == pytest.approx(here.pictures_m, abs=1e-6)
    assert there.covered == pytest.approx(here.covered, abs=1e-6)
    assert there.lines_rad == here.lines_rad


@pytest.mark.parametrize(
    ("turn_deg", "across_px", "along_px"),
    [(0.0, 640.0, 480.0), (180.0, 640.0, 480.0), (90.0, 480.0, 640.0), (-90.0, 480.0, 640.0), (45.0, 387.88, 290.91)],
)
def test_pictures_of_a_turned_camera_overlap_as_the_goal_says(
    turn_deg: float, across_px: float, along_px: float
) -> None:
    """At 45 degrees the share of both sides is 480 / (640 + 480) * sqrt(2) = 0.6061."""
    camera = CameraMountConfig(width_px=640, height_px=480, turn_rad=radians(turn_deg))
    config = ActionsConfig(vehicle=VehicleConfig(camera=camera))
    goal = AreaCoverageGoal(
        polygon_ned_m=((0.0, 0.0), (0.0, 40.0), (40.0, 40.0), (40.0, 0.0)), z_ned_m=-8.0, overlap=0.5
    )
    plan = plan_coverage(goal, config)
    m_per_px = 8.0 / camera.focal_px
    assert plan.line_distance_m == pytest.approx(0.5 * m_per_px * across_px, rel=1e-4)
    assert plan.picture_distance_m == pytest.approx(0.5 * m_per_px * along_px, rel=1e-4)


def test_the_rest_of_a_motion_begins_at_rest_where_it_is_taken_up() -> None:
    path_m = plan_path(make_area(SQUARE), 0.5)
    whole = make_trajectory(path_m, speed_mps=1.0, acceleration_mps2=1.0, cut_m=0.25)
    rest = make_trajectory(path_m, speed_mps=1.0, acceleration_mps2=1.0, cut_m=0.25, from_m=7.3)
    assert rest.length_m == pytest.approx(whole.length_m - 7.3, abs=1e-6)
    assert rest.pos_m[0] == pytest.approx(whole.at(float(np.interp(7.3, whole.distance_m, whole.t_s)))[0], abs=0.01)
    assert np.linalg.norm(rest.vel_mps[0]) == 0.0


def test_covered_ground_is_what_the_way_came_near() -> None:
    ground = CoveredGround(make_area(SQUARE), 1.0)
    assert ground.fraction == 0.0
    ground.mark_way(np.array(((0.0, 2.0), (4.0, 2.0))))
    assert ground.fraction == pytest.approx(0.25, abs=0.01)
    ground.mark(100.0, 100.0)
    assert ground.fraction == pytest.approx(0.25, abs=0.01)


def test_holes_are_flown_around() -> None:
    hole: tuple[Point, ...] = ((1.5, 1.5), (1.5, 2.5), (2.5, 2.5), (2.5, 1.5))
    area = make_area(SQUARE, [hole])
    assert LineString(plan_path(area, 0.3)).intersection(Polygon(hole).buffer(-1e-6)).is_empty


@pytest.mark.parametrize(
    ("polygon", "holes", "why"),
    [
        (((0, 0), (1, 1)), (), "2 different corners: three are the least"),
        (((0, 0), (2, 2), (2, 0), (0, 2)), (), "crosses or touches itself"),
        (((0, 0), (1, 1), (2, 2)), (), "on one line|crosses or touches"),
        (SQUARE, [((3, 3), (5, 3), (5, 5), (3, 5))], "hole 1 is not wholly inside"),
        (SQUARE, [((1, 1), (1, 1), (1, 1))], "hole 1 has 1 different corners"),
    ],
)
def test_areas_that_make_no_sense_are_refused_with_the_reason(
    polygon: tuple[Point, ...], holes: list[tuple[Point, ...]], why: str
) -> None:
    with pytest.raises(AreaError, match=why):
        make_area(polygon, holes)


def test_a_motion_keeps_its_speed_and_acceleration_and_ends_at_rest() -> None:
    flown = fly(make_area(THESIS), 0.25, speed_mps=1.3)
    speeds = np.linalg.norm(flown.vel_mps, axis=1)
    assert speeds.max() <= 1.3 + 1e-9
    assert speeds[0] == speeds[-1] == 0.0
    assert np.linalg.norm(flown.acc_mps2, axis=1).max() <= 1.0 + 1e-6
    middle_s = 0.5 * flown.duration_s
    before, after = flown.at(middle_s - 0.01)[0], flown.at(middle_s + 0.01)[0]
    assert flown.at(middle_s)[1] == pytest.approx((after - before) / 0.02, abs=0.1)
    assert flown.at(flown.duration_s + 1.0)[1] == pytest.approx((0.0, 0.0))


def test_a_turn_begins_and_ends_straight_and_stays_within_its_corner() -> None:
    flown = make_trajectory(
        np.array(((0.0, 0.0), (4.0, 0.0), (4.0, 4.0))), speed_mps=1.0, acceleration_mps2=1.0, cut_m=0.5
    )
    assert flown.pos_m[:, 0].max() <= 4.0
    assert flown.pos_m[:, 1].min() >= 0.0
    before = flown.pos_m[flown.pos_m[:, 0] < 3.5 - 1e-9]
    assert np.abs(before[:, 1]).max() < 1e-9


def coverage(**fields: Any) -> CoveragePlan:
    """Plan of a field of 40 m by 30 m, with lines 3 m apart."""
    polygon = ((0.0, 0.0), (40.0, 0.0), (40.0, 30.0), (0.0, 30.0))
    goal = AreaCoverageGoal(polygon_ned_m=polygon, z_ned_m=-5.0, margin_holes_m=0.0, **({"resolution_m": 3.0} | fields))
    return plan_coverage(goal, ActionsConfig(), (0.0, 0.0))


@pytest.mark.parametrize("angle_deg", [0, 30, 45, 90, 135, 170, 350, -30])
def test_the_lines_have_the_direction_that_the_goal_gives(angle_deg: int) -> None:
    plan = coverage(angle_rad=radians(angle_deg))
    assert plan.lines_rad == pytest.approx(radians(angle_deg) % np.pi)
    inside = plan.area.buffer(-4.0)  # without the pass along the outline, and the turns beside it
    legs = np.diff(plan.trajectory.pos_m, axis=0)
    middles = plan.trajectory.pos_m[:-1] + 0.5 * legs
    kept = shapely.contains_xy(inside, middles)
    lengths_m = np.linalg.norm(legs, axis=1)
    off = np.abs((np.arctan2(legs[:, 1], legs[:, 0]) - radians(angle_deg) + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
    along_m = lengths_m[kept & (off < radians(2.0))].sum()
    assert along_m > 0.8 * lengths_m[kept].sum()
    assert plan.covered >= 0.99


def test_without_a_direction_the_path_is_the_shortest_one() -> None:
    free = coverage()
    assert all(free.trajectory.length_m <= coverage(angle_rad=radians(a)).trajectory.length_m + 1.0 for a in (0, 37))


@pytest.mark.parametrize(
    ("fields", "lines_m", "pictures_m"),
    [
        ({"resolution_m": 3.0, "picture_distance_m": 1.5}, 3.0, 1.5),
        ({"resolution_m": 2.0, "picture_distance_m": 5.0}, 2.0, 5.0),
        ({"resolution_m": 3.0}, 3.0, 3.0),
        ({"resolution_m": None, "sidelap": 0.5, "picture_distance_m": 1.5}, None, 1.5),
    ],
)
def test_images_on_a_line_have_the_distance_that_the_goal_gives(
    fields: dict[str, Any], lines_m: float | None, pictures_m: float
) -> None:
    plan = coverage(**fields)
    assert plan.picture_distance_m == pictures_m
    assert lines_m is None or plan.line_distance_m == lines_m
    assert len(plan.pictures_m) == pytest.approx(plan.trajectory.length_m / pictures_m, abs=2.0)


def test_an_overlap_and_a_distance_between_images_are_refused() -> None:
    with pytest.raises(AreaError, match="an overlap and a distance between images are both given"):
        coverage(resolution_m=None, overlap=0.7, picture_distance_m=1.0)
