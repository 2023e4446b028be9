"""The coverage plan of a goal: path, trajectory and pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import cos, floor, sin

import numpy as np
from shapely.affinity import translate
from shapely.geometry import Polygon

from jezero.base.arrays import Array
from jezero.base.frames import Vec3, add, altitude_m
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import (
    AreaError,
    FlightArea,
    PlaceNames,
    Point,
    flight_area,
    repair_area,
)
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.area_coverage.ground import CoveredGround, photographed_fraction, planned_footprint
from jezero.services.actions.area_coverage.path import covered_fraction, distance_outside_m, plan_path
from jezero.services.actions.area_coverage.trajectory import Trajectory, make_trajectory, picture_distances, turn_cuts
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.limits import high_or_far_refusal, low_refusal, speed_refusal

CUTS = (0.5, 0.25, 0.1)
"""Distances before a corner at which its turn begins, in line distances: wide turns are faster, narrow ones leave out
less of the ground at their corner."""
COVERED_MIN = 0.99
"""Fraction of the area that must be covered, for wide turns."""
OUTSIDE_MAX_M = 0.05
"""A path that leaves its area or its margins farther than this is not flown, whatever planned it."""
DIRECTION_RAD = np.pi / 180.0
"""Directions nearer to each other than this are the same."""
PHOTOGRAPHED_MIN = 0.9
"""A plan whose pictures show less of the area is refused: somebody who wants pictures of all of it has taken a wrong
number. Along the edge of the area some percent may be missing in a good plan too."""
PHOTOGRAPHED_GOOD = 0.99
OVERLAP_GOOD = 0.5
"""With less overlap, a tilt of some degrees or a drift of half a metre leaves a gap beside a picture, and too little
ground is on two pictures for a map to tie them together."""


@dataclass(frozen=True)
class Photographs:
    """The pictures of a plan, each of a vehicle that flies level over level ground.

    Attributes:
        footprint_m: (4, 2) north and east of a picture's corners on the ground, from the point of the picture.
        size_m: width across and along the lines of the part of a picture that counts.
        line_distance_m: between neighbouring lines.
        picture_distance_m: between pictures along the path.
        count: number of pictures.
        fraction: photographed fraction of the area.
    """

    footprint_m: Array
    size_m: tuple[float, float]
    line_distance_m: float
    picture_distance_m: float
    count: int
    fraction: float

    @property
    def overlap(self) -> tuple[float, float]:
        """Fraction of a picture that the picture beside it, and the next one on the line, show again; 0 at least."""
        across_m, along_m = self.size_m
        return max(0.0, 1.0 - self.line_distance_m / across_m), max(0.0, 1.0 - self.picture_distance_m / along_m)

    def refusal(self) -> str:
        """Reason why the pictures would show too little of the area, with what to change, or ""."""
        if self.fraction >= PHOTOGRAPHED_MIN:
            return ""
        return (
            f"only {floor(100.0 * self.fraction)} % of the area would be in the pictures: {self._spacing()}; take a "
            f"resolution of {0.5 * min(self.size_m):.2g} m, or an overlap of 0.5, or fly higher; with force (--force) "
            "it is flown like this"
        )

    def warnings(self) -> Iterator[str]:
        """What the user should know before the flight."""
        if self.fraction < PHOTOGRAPHED_GOOD:
            yield f"only {floor(100.0 * self.fraction)} % of the area will be in the pictures: {self._spacing()}"
        if self.count > 1 and min(self.overlap) < OVERLAP_GOOD - 1e-6:
            across, along = (100.0 * overlap for overlap in self.overlap)
            yield (
                f"pictures overlap by {along:.0f} % along the lines and {across:.0f} % across them: below "
                f"{100.0 * OVERLAP_GOOD:.0f} %, tilt and drift leave gaps, and a map can't tie all pictures together"
            )

    def _spacing(self) -> str:
        across_m, along_m = self.size_m
        return (
            f"each shows {across_m:.1f} m x {along_m:.1f} m of the ground, lines are {self.line_distance_m:.4g} m and "
            f"pictures {self.picture_distance_m:.4g} m apart"
        )


@dataclass(frozen=True)
class CoveragePlan:
    """A coverage before it is flown; points are (north, east) in the goal's frame.

    Attributes:
        area: to be covered: without holes, and without what the margins leave out.
        line_distance_m: between neighbouring lines.
        picture_distance_m: between pictures along the path.
        start_m: (2,) point near which the path begins.
        trajectory: motion along the path, from the first picture on.
        pictures_m: (n, 2) points at which pictures are taken.
        first_picture: index of the picture at which the trajectory begins.
        picture_times_s: (n - first_picture,) times of the pictures, in the trajectory's time.
        ground: the area, of which the part before the first picture is covered; for one flight.
        lines_rad: the goal's direction of the lines, else that of most of the path, 0 to pi from north towards east;
            either way along the lines.
        covered: covered fraction of the area: the part within half a line distance of the path.
        photographs: what the pictures show of the area.
        vehicle_m: (2,) position of the vehicle at the planning; None when nobody knew it.
        warning: what the user should know before the flight, or "".
    """

    area: Polygon
    line_distance_m: float
    picture_distance_m: float
    start_m: tuple[float, float]
    trajectory: Trajectory
    pictures_m: Array
    first_picture: int
    picture_times_s: Array
    ground: CoveredGround
    lines_rad: float
    covered: float
    photographs: Photographs
    vehicle_m: tuple[float, float] | None
    warning: str


def plan_coverage(
    goal: AreaCoverageGoal,
    config: ActionsConfig,
    start_m: Sequence[float] | None = None,
    origin_ned_m: Vec3 = (0.0, 0.0, 0.0),
) -> CoveragePlan:
    """Plan the coverage of a goal.

    Args:
        start_m: (2,) the vehicle's position in the goal's frame; the path begins near it, unless the goal has a start.
        origin_ned_m: of the goal's frame in the world, for the limits.

    Raises:
        AreaError: the goal can't be flown; with the reason and what to change.
    """
    corner_m = goal.polygon_ned_m[0] if goal.polygon_ned_m else (0.0, 0.0)
    holes_m = [_from(corner_m, hole) for hole in goal.holes_ned_m]
    places = PlaceNames(corner_m, goal.origin_deg)
    repaired = repair_area(_from(corner_m, goal.polygon_ned_m), holes_m, places)
    if reason := _refusal(goal, config.vehicle, origin_ned_m):
        raise AreaError(reason)
    across_m, along_m = _distances(goal, config.vehicle.camera)
    ground = flight_area(repaired, across_m, margin_outline_m=goal.margin_outline_m, margin_holes_m=goal.margin_holes_m)
    area = ground.sweep
    _check_count(area.area / across_m / along_m, f"the area of {area.area:.0f} m² needs about", config.area_coverage)
    start = goal.start_ned_m or start_m
    near_m = None if start is None else _from(corner_m, [start])[0]
    site = _site(ground, across_m, near_m, goal.angle_rad, _motion(goal, config)).moved(corner_m, repaired.warnings)
    vehicle_m = None if start_m is None else (float(start_m[0]), float(start_m[1]))
    first_m = site.path_m[0] if start is None else start
    return _with_pictures(goal, config, origin_ned_m, site, (float(first_m[0]), float(first_m[1])), vehicle_m)


@dataclass(frozen=True)
class _Site:
    """An area with its path.

    Attributes:
        area: to be covered.
        path_m: (n, 2) corners of the path.
        cuts_m: (n,) distances before the corners at which their turns begin.
        whole: motion along the whole path.
        covered: covered fraction of the area.
        warnings: what the area and the margins give reason for.
    """

    area: Polygon
    path_m: Array
    cuts_m: Array
    whole: Trajectory
    covered: float
    warnings: tuple[str, ...]

    def moved(self, by_m: Point, warnings: tuple[str, ...]) -> "_Site":
        """The same elsewhere, with more warnings in front."""
        return replace(
            self,
            area=translate(self.area, *by_m),
            path_m=self.path_m + np.array(by_m),
            whole=replace(self.whole, pos_m=self.whole.pos_m + np.array(by_m)),
            warnings=(*warnings, *self.warnings),
        )


def _site(
    ground: FlightArea, across_m: float, start_m: Point | None, angle_rad: float | None, motion: dict[str, float]
) -> _Site:
    """Plan the path over the ground of an area, with the widest turns that leave out little of it.

    Raises:
        AreaError: the path would leave the ground over which it may lead.
    """
    path_m = plan_path(ground.sweep, across_m, start_m, ground.fly, angle_rad)
    for cut in CUTS:
        cuts_m = turn_cuts(path_m, ground.fly, cut * across_m)
        whole = make_trajectory(path_m, cut_m=cuts_m, **motion)
        covered = covered_fraction(ground.sweep, whole.pos_m, across_m)
        if covered >= COVERED_MIN:
            break
    if (outside_m := distance_outside_m(whole.pos_m, ground.fly)) > OUTSIDE_MAX_M:
        raise AreaError(
            f"the path would leave the area or its margins by {outside_m:.2f} m, so it is not flown: simplify the "
            "outline, take smaller margins, or map the area in parts"
        )
    return _Site(ground.sweep, path_m, cuts_m, whole, covered, ground.warnings)


def _with_pictures(
    goal: AreaCoverageGoal,
    config: ActionsConfig,
    origin_ned_m: Vec3,
    site: _Site,
    start_m: Point,
    vehicle_m: Point | None,
) -> CoveragePlan:
    """The plan along a path.

    Raises:
        AreaError: there are too many pictures, or they show too little of the area.
    """
    area, whole = site.area, site.whole
    across_m, along_m = _distances(goal, config.vehicle.camera)
    motion = _motion(goal, config)
    at_m = picture_distances(whole.length_m, along_m)
    _check_count(len(at_m), f"the path of {whole.length_m:.0f} m needs", config.area_coverage)
    if goal.first_picture >= len(at_m):
        raise AreaError(f"there is no picture {goal.first_picture}: this coverage has {len(at_m)}, counted from 0")
    pictures_m = np.column_stack([np.interp(at_m, whole.distance_m, whole.pos_m[:, k]) for k in (0, 1)])
    ground = CoveredGround(area, across_m)
    first_m = at_m[goal.first_picture]
    rest = whole
    if goal.first_picture:
        rest = make_trajectory(site.path_m, cut_m=site.cuts_m, **motion, from_m=first_m)
        ground.mark_way(whole.pos_m[whole.distance_m <= first_m])
    lines_rad = _main_direction_rad(whole.pos_m) if goal.angle_rad is None else goal.angle_rad % np.pi
    photographs = _photographs(goal, config.vehicle.camera, origin_ned_m, area, pictures_m, lines_rad)
    if (reason := photographs.refusal()) and not goal.force:
        raise AreaError(reason)
    planned = _warnings(goal, config.vehicle, origin_ned_m, motion["speed_mps"])
    warnings = (*site.warnings, *planned, *photographs.warnings())
    return CoveragePlan(
        area=area,
        line_distance_m=across_m,
        picture_distance_m=along_m,
        start_m=start_m,
        trajectory=rest,
        pictures_m=pictures_m,
        first_picture=goal.first_picture,
        picture_times_s=np.interp(at_m[goal.first_picture :] - first_m, rest.distance_m, rest.t_s),
        ground=ground,
        lines_rad=lines_rad,
        covered=site.covered,
        photographs=photographs,
        vehicle_m=vehicle_m,
        warning="; ".join(warnings),
    )


def _check_count(pictures: float, what: str, config: AreaCoverageConfig) -> None:
    """Refuse more pictures than a result can list.

    Raises:
        AreaError: there are too many.
    """
    if pictures > (most := config.pictures_max):
        raise AreaError(
            f"{what} {np.rint(pictures):.6g} pictures, more than {most}: take a coarser resolution or less overlap, or "
            "map it in parts"
        )


def _motion(goal: AreaCoverageGoal, config: ActionsConfig) -> dict[str, float]:
    """How a path is flown: arguments of `make_trajectory`."""
    _, along_m = _distances(goal, config.vehicle.camera)
    settings = config.area_coverage
    return {
        "speed_mps": min(goal.speed_mps or settings.speed_mps, 0.5 * along_m * config.vehicle.camera.rate_hz),
        "acceleration_mps2": settings.acceleration_mps2,
    }


def _main_direction_rad(path_m: Array) -> float:
    """Direction of most of a path, 0 to pi from north towards east."""
    steps_m = np.diff(path_m, axis=0)
    lengths_m = np.linalg.norm(steps_m, axis=1)
    directions = np.round(np.arctan2(steps_m[:, 1], steps_m[:, 0]) % np.pi / DIRECTION_RAD).astype(int)
    most = int(np.argmax(np.bincount(directions % round(np.pi / DIRECTION_RAD), lengths_m)))
    return most * DIRECTION_RAD


def _photographs(
    goal: AreaCoverageGoal,
    camera: CameraMountConfig,
    origin_ned_m: Vec3,
    area: Polygon,
    pictures_m: Array,
    lines_rad: float,
) -> Photographs:
    """What pictures at these points show of the area."""
    height_m = altitude_m(goal.z_ned_m + origin_ned_m[2])
    footprint_m = planned_footprint(camera, lines_rad, height_m)
    across_px, along_px = _upright_px(camera)
    m_per_px = height_m / camera.focal_px
    across_m, along_m = _distances(goal, camera)
    return Photographs(
        footprint_m=footprint_m,
        size_m=(m_per_px * across_px, m_per_px * along_px),
        line_distance_m=across_m,
        picture_distance_m=along_m,
        count=len(pictures_m),
        fraction=photographed_fraction(area, pictures_m, footprint_m),
    )


def _warnings(goal: AreaCoverageGoal, vehicle: VehicleConfig, origin_ned_m: Vec3, speed_mps: float) -> Iterator[str]:
    """What is flown in another way than the goal says, besides what the pictures show."""
    if goal.force and (unmapped := _map_refusal(goal, vehicle, origin_ned_m)):
        yield unmapped
    if goal.speed_mps is not None and speed_mps < goal.speed_mps:
        yield f"flown at {speed_mps:.2g} m/s instead of {goal.speed_mps:g} m/s: the camera takes no more pictures"


def _map_refusal(goal: AreaCoverageGoal, vehicle: VehicleConfig, origin_ned_m: Vec3) -> str:
    """Reason why no map can be made of the pictures, or ""."""
    up_m = altitude_m(goal.z_ned_m + origin_ned_m[2])
    up_max_m = vehicle.altimeter.range_max_m - vehicle.height_altimeter_m
    if up_m <= up_max_m:
        return ""
    return (
        f"at {up_m:g} m the altimeter does not reach the ground, so jezero makes no map of the pictures; the highest "
        f"flight for a map is at {floor(10.0 * up_max_m) / 10.0:g} m"
    )


def _from(corner_m: Point, points_m: Sequence[Sequence[float]]) -> list[Point]:
    """Points relative to a corner, to the tenth of a millimetre: the same area elsewhere gets the same plan."""
    return [(round(point[0] - corner_m[0], 4), round(point[1] - corner_m[1], 4)) for point in points_m]


def _refusal(goal: AreaCoverageGoal, vehicle: VehicleConfig, origin_ned_m: Vec3) -> str:
    """Reason why a goal's numbers can't be flown, whatever its shape is, or ""."""
    if reason := low_refusal(goal.z_ned_m, vehicle.limits):
        return reason
    for north_m, east_m in goal.polygon_ned_m:
        corner_ned_m = add((north_m, east_m, goal.z_ned_m), origin_ned_m)
        if reason := high_or_far_refusal(corner_ned_m, vehicle.limits):
            return reason
    if not goal.force and (reason := _map_refusal(goal, vehicle, origin_ned_m)):
        return f"{reason}: fly lower, or with force (--force) to take them all the same"
    return _frame_refusal(goal) or speed_refusal(goal.speed_mps, vehicle.limits)


def _frame_refusal(goal: AreaCoverageGoal) -> str:
    """Reason why a goal's fields don't fit its frame or its start, or ""."""
    if goal.first_picture and goal.start_ned_m is None:
        return "a coverage that goes on with first_picture needs the start_ned_m of the one before: it is in its result"
    if goal.frame == "world":
        return ""
    if goal.first_picture:
        return "a coverage goes on in frame 'world' only: its result holds the goal that does"
    if goal.origin_deg is not None:
        return f"an area in degrees is in frame 'world' only: leave out origin_deg in frame '{goal.frame}'"
    return ""


def _distances(goal: AreaCoverageGoal, camera: CameraMountConfig) -> tuple[float, float]:
    """Distance between lines and between pictures."""
    overlap = goal.sidelap if goal.overlap is None else goal.overlap
    sidelap = goal.overlap if goal.sidelap is None else goal.sidelap
    if overlap is None or sidelap is None:
        if not goal.resolution_m:
            raise AreaError("give a resolution above 0 m, or an overlap of the pictures")
        return goal.resolution_m, goal.picture_distance_m or goal.resolution_m
    if goal.resolution_m is not None:
        raise AreaError("a resolution and an overlap are both given: choose one of them")
    if goal.picture_distance_m is not None and goal.overlap is not None:
        raise AreaError("an overlap and a distance between images are both given: choose one of them")
    across_px, along_px = _upright_px(camera)
    m_per_px = altitude_m(goal.z_ned_m) / camera.focal_px
    along_m = goal.picture_distance_m or m_per_px * along_px * (1.0 - overlap)
    return m_per_px * across_px * (1.0 - sidelap), along_m


def _upright_px(camera: CameraMountConfig) -> tuple[float, float]:
    """Size across and along the lines of the part of an image that counts.

    For a camera that is turned about its optical axis, the part is the greatest upright rectangle of the image's shape.
    """
    c, s = abs(cos(camera.turn_rad)), abs(sin(camera.turn_rad))
    width_px, height_px = camera.width_px, camera.height_px
    across_px, along_px = (height_px, width_px) if s > c else (width_px, height_px)
    share = min(width_px / (across_px * c + along_px * s), height_px / (across_px * s + along_px * c))
    return share * across_px, share * along_px
