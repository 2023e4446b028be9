"""From the goal of an area coverage to its plan, or to the reason why there is none."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon

from jezero.frames import altitude_m
from jezero.schemas.actions import AreaCoverageGoal
from jezero.services.actions.checks import point_refusal, speed_refusal
from jezero.services.actions.config import ActionsConfig, CoverageConfig
from jezero.services.actions.coverage.area import AreaError, make_area
from jezero.services.actions.coverage.plan import covered_share, plan_path
from jezero.services.actions.coverage.trajectory import Trajectory, make_trajectory, picture_distances

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CoveragePlan:
    """A coverage before it is flown; (north, east) in the goal's frame.

    Attributes:
        line_distance_m, picture_distance_m: across and along.
        pictures_m: (n, 2) where pictures are taken.
    """

    area: Polygon
    line_distance_m: float
    picture_distance_m: float
    trajectory: Trajectory
    pictures_m: Array

    @property
    def covered(self) -> float:
        """Share of the area within half a line distance of the path."""
        return covered_share(self.area, self.trajectory.pos_m, self.line_distance_m)


def plan_coverage(
    goal: AreaCoverageGoal, config: ActionsConfig, start_m: Sequence[float] | None = None
) -> CoveragePlan:
    """The plan of a goal.

    Args:
        start_m: (2,) where the vehicle is, in the goal's frame; the path begins near it.

    Raises:
        AreaError: the goal can't be flown; why, and what to change.
    """
    area = make_area(goal.polygon_ned_m, goal.holes_ned_m)
    for north_m, east_m in goal.polygon_ned_m:
        if reason := point_refusal((north_m, east_m, goal.z_ned_m), config.limits):
            raise AreaError(reason)
    if reason := speed_refusal(goal.speed_mps, config.limits):
        raise AreaError(reason)
    settings = config.area_coverage
    across_m, along_m = _distances(goal, settings)
    if area.area / across_m > settings.pictures_max * along_m:
        raise AreaError(
            f"the area of {area.area:.0f} m² needs about {area.area / across_m / along_m:.0f} pictures, more than "
            f"{settings.pictures_max}: take a coarser resolution, or map it in parts"
        )
    speed_mps = min(goal.speed_mps or settings.speed_mps, 0.5 * along_m * settings.camera_rate_hz)
    trajectory = make_trajectory(
        plan_path(area, across_m, start_m),
        speed_mps=speed_mps,
        acceleration_mps2=settings.acceleration_mps2,
        cut_m=settings.cut * across_m,
    )
    at_m = picture_distances(trajectory.length_m, along_m)
    pictures_m = np.column_stack([np.interp(at_m, trajectory.distance_m, trajectory.pos_m[:, k]) for k in (0, 1)])
    return CoveragePlan(area, across_m, along_m, trajectory, pictures_m)


def _distances(goal: AreaCoverageGoal, settings: CoverageConfig) -> tuple[float, float]:
    """Between lines and between pictures. The camera's wide side lies across the lines."""
    if goal.overlap is None and goal.sidelap is None:
        if not goal.resolution_m:
            raise AreaError("give a resolution above 0 m, or an overlap of the pictures")
        return goal.resolution_m, goal.resolution_m
    if goal.resolution_m is not None:
        raise AreaError("a resolution and an overlap are both given: choose one of them")
    overlap = goal.sidelap if goal.overlap is None else goal.overlap
    sidelap = goal.overlap if goal.sidelap is None else goal.sidelap
    assert overlap is not None
    assert sidelap is not None
    m_per_px = altitude_m(goal.z_ned_m) / settings.focal_px
    return m_per_px * settings.width_px * (1.0 - sidelap), m_per_px * settings.height_px * (1.0 - overlap)
