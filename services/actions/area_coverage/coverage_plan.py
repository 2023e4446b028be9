"""The coverage plan of a goal: path, trajectory and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray
from shapely.affinity import translate
from shapely.geometry import Polygon

from jezero.frames import Vec3, add, altitude_m
from jezero.schemas.actions import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import AreaError, Point, make_area
from jezero.services.actions.area_coverage.ground import CoveredGround
from jezero.services.actions.area_coverage.path import covered_fraction, plan_path
from jezero.services.actions.area_coverage.trajectory import Trajectory, make_trajectory, picture_distances
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.limits import beyond_limits, low_refusal, speed_refusal
from jezero.vehicle_config import CameraMountConfig

Array = NDArray[np.float64]
CUT = 0.5
"""Distance before a corner at which its turn begins, in line distances."""
DIRECTION_RAD = np.pi / 180.0
"""Directions nearer to each other than this are the same."""


@dataclass(frozen=True)
class CoveragePlan:
    """A coverage before it is flown; points are (north, east) in the goal's frame.

    Attributes:
        area: to be covered.
        line_distance_m: between neighbouring lines.
        picture_distance_m: between pictures along the path.
        start_m: (2,) point near which the path begins.
        trajectory: motion along the path, from the first picture on.
        pictures_m: (n, 2) points at which pictures are taken.
        first_picture: index of the picture at which the trajectory begins.
        picture_times_s: (n - first_picture,) times of the pictures, in the trajectory's time.
        ground: the area, of which the part before the first picture is covered.
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

    @property
    def covered(self) -> float:
        """Covered fraction of the area: the part within half a line distance of the path."""
        return covered_fraction(self.area, self.trajectory.pos_m, self.line_distance_m)

    @property
    def lines_rad(self) -> float:
        """Direction of most of the path, 0 to pi from north towards east; either way along the lines."""
        steps_m = np.diff(self.trajectory.pos_m, axis=0)
        lengths_m = np.linalg.norm(steps_m, axis=1)
        directions = np.round(np.arctan2(steps_m[:, 1], steps_m[:, 0]) % np.pi / DIRECTION_RAD).astype(int)
        most = int(np.argmax(np.bincount(directions % round(np.pi / DIRECTION_RAD), lengths_m)))
        return most * DIRECTION_RAD


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
    area = make_area(_from(corner_m, goal.polygon_ned_m), [_from(corner_m, hole) for hole in goal.holes_ned_m])
    if reason := _refusal(goal, config, origin_ned_m):
        raise AreaError(reason)
    settings = config.area_coverage
    across_m, along_m = _distances(goal, config.vehicle.camera)
    if area.area / across_m > settings.pictures_max * along_m:
        raise AreaError(
            f"the area of {area.area:.0f} m² needs about {area.area / across_m / along_m:.0f} pictures, more than "
            f"{settings.pictures_max}: take a coarser resolution, or map it in parts"
        )
    motion = {
        "speed_mps": min(goal.speed_mps or settings.speed_mps, 0.5 * along_m * config.vehicle.camera.rate_hz),
        "acceleration_mps2": settings.acceleration_mps2,
        "cut_m": CUT * across_m,
    }
    start = goal.start_ned_m or start_m
    near_m = None if start is None else _from(corner_m, [start])[0]
    path_m = plan_path(area, across_m, near_m) + np.array(corner_m)
    area = translate(area, *corner_m)
    whole = make_trajectory(path_m, **motion)
    at_m = picture_distances(whole.length_m, along_m)
    if goal.first_picture >= len(at_m):
        raise AreaError(f"there is no picture {goal.first_picture}: this coverage has {len(at_m)}, counted from 0")
    pictures_m = np.column_stack([np.interp(at_m, whole.distance_m, whole.pos_m[:, k]) for k in (0, 1)])
    ground = CoveredGround(area, across_m)
    first_m = at_m[goal.first_picture]
    rest = whole
    if goal.first_picture:
        rest = make_trajectory(path_m, **motion, from_m=first_m)
        ground.mark_way(whole.pos_m[whole.distance_m <= first_m])
    times_s = np.interp(at_m[goal.first_picture :] - first_m, rest.distance_m, rest.t_s)
    begin_m = (float(path_m[0][0]), float(path_m[0][1])) if start is None else (float(start[0]), float(start[1]))
    return CoveragePlan(area, across_m, along_m, begin_m, rest, pictures_m, goal.first_picture, times_s, ground)


def _from(corner_m: Point, points_m: Sequence[Sequence[float]]) -> list[Point]:
    """Points relative to a corner, to the tenth of a millimetre: the same area elsewhere gets the same plan."""
    return [(round(point[0] - corner_m[0], 4), round(point[1] - corner_m[1], 4)) for point in points_m]


def _refusal(goal: AreaCoverageGoal, config: ActionsConfig, origin_ned_m: Vec3) -> str:
    """Reason why a goal's numbers can't be flown, whatever its shape is, or ""."""
    if reason := low_refusal(goal.z_ned_m, config.vehicle.limits):
        return reason
    for north_m, east_m in goal.polygon_ned_m:
        corner_ned_m = add((north_m, east_m, goal.z_ned_m), origin_ned_m)
        if reason := beyond_limits(corner_ned_m, config.vehicle.limits):
            return reason
    if goal.first_picture and goal.start_ned_m is None:
        return "a coverage that goes on with first_picture needs the start_ned_m of the one before: it is in its result"
    if goal.first_picture and goal.frame != "world":
        return "a coverage goes on in frame 'world' only: its result holds the goal that does"
    return speed_refusal(goal.speed_mps, config.vehicle.limits)


def _distances(goal: AreaCoverageGoal, camera: CameraMountConfig) -> tuple[float, float]:
    """Distance between lines and between pictures."""
    overlap = goal.sidelap if goal.overlap is None else goal.overlap
    sidelap = goal.overlap if goal.sidelap is None else goal.sidelap
    if overlap is None or sidelap is None:
        if not goal.resolution_m:
            raise AreaError("give a resolution above 0 m, or an overlap of the pictures")
        return goal.resolution_m, goal.resolution_m
    if goal.resolution_m is not None:
        raise AreaError("a resolution and an overlap are both given: choose one of them")
    across_px, along_px = _upright_px(camera)
    m_per_px = altitude_m(goal.z_ned_m) / camera.focal_px
    return m_per_px * across_px * (1.0 - sidelap), m_per_px * along_px * (1.0 - overlap)


def _upright_px(camera: CameraMountConfig) -> tuple[float, float]:
    """Size across and along the lines of the part of an image that counts.

    For a camera that is turned about its optical axis, the part is the greatest upright rectangle of the image's shape.
    """
    c, s = abs(cos(camera.turn_rad)), abs(sin(camera.turn_rad))
    width_px, height_px = camera.width_px, camera.height_px
    across_px, along_px = (height_px, width_px) if s > c else (width_px, height_px)
    share = min(width_px / (across_px * c + along_px * s), height_px / (across_px * s + along_px * c))
    return share * across_px, share * along_px
