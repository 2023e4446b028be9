"""Quality of a coverage of the thesis' polygon, in virtual time, in 3 m/s mean wind with gusts of 0.6 m/s.

`python -m benchmarks.quality.coverage [--seeds N]` flies it at 1 m/s and 5 m up, with lines 0.25 m and 0.15 m apart.
Errors across the path are those of the vehicle's own estimate, with the true ones beside them. The camera is the
simulator's, but its pictures are black: none is looked at here.
"""

import argparse
from dataclasses import dataclass
from math import sqrt
from time import process_time

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString

from benchmarks.quality.covering import Covering
from jezero.schemas.goals import AreaCoverageGoal, Corners
from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan, plan_coverage
from jezero.services.actions.area_coverage.path import covered_fraction
from jezero.services.actions.config import ActionsConfig

THESIS = ((0.0, 0.0), (3.0, 5.0), (7.0, 4.0), (7.0, 2.0), (4.0, 1.0), (3.0, 2.0), (0.0, 0.0))
RESOLUTIONS_M = (0.25, 0.15)
Z_NED_M = -5.0


@dataclass(frozen=True)
class Figures:
    """Figures of one flight.

    Attributes:
        across_m: RMS distance from the path, by the vehicle's estimate.
        across_max_m: largest distance from the path, by the vehicle's estimate.
        true_across_m: RMS distance from the path, by the truth.
        height_m: RMS error of the height.
        pictures: number of pictures.
        pictures_per_length: number of pictures divided by the number of resolutions in the path's length.
        covered: fraction of the area near the planned path.
        length_ratio: length of the path divided by the area over the line distance.
        planning_s: processor time of the planning.
        flown_covered: fraction of the area near the path flown, by the vehicle's estimate.
        place_m: median distance of a picture's recorded position from its planned point.
        time_s: duration of the flight along the path.
    """

    across_m: float
    across_max_m: float
    true_across_m: float
    height_m: float
    pictures: int
    pictures_per_length: float
    covered: float
    length_ratio: float
    planning_s: float
    flown_covered: float
    place_m: float
    time_s: float


def measure(seed: int, resolution_m: float, polygon_ned_m: Corners = THESIS) -> Figures:
    """Fly one coverage and evaluate it."""
    goal = AreaCoverageGoal(
        goal_id="map", polygon_ned_m=polygon_ned_m, z_ned_m=Z_NED_M, resolution_m=resolution_m, start_ned_m=(0.0, 0.0)
    )
    flight = Covering(seed, rendered=False)
    result = flight.fly(goal)
    assert flight.mapping_ns is not None
    begin_s = process_time()
    plan = plan_coverage(goal, ActionsConfig())
    planning_s = process_time() - begin_s
    first_ns, last_ns = flight.mapping_ns
    own = np.array([o.pos_uav_ned_m for o in flight.odometry if first_ns <= o.t_ns <= last_ns])
    true = np.array([t.pos_uav_ned_m for t in flight.truths if first_ns <= t.t_ns <= last_ns])
    across_m = _across_m(plan, own)
    taken_m = np.array([image.pos_uav_ned_m[:2] for image in result.images])
    return Figures(
        across_m=_rms(across_m),
        across_max_m=float(across_m.max()),
        true_across_m=_rms(_across_m(plan, true)),
        height_m=_rms(own[:, 2] - Z_NED_M),
        pictures=len(result.images),
        pictures_per_length=len(result.images) * resolution_m / plan.trajectory.length_m,
        covered=plan.covered,
        length_ratio=plan.trajectory.length_m * resolution_m / plan.area.area,
        planning_s=planning_s,
        flown_covered=covered_fraction(plan.area, own[:, :2], resolution_m),
        place_m=float(np.median(np.linalg.norm(taken_m - plan.pictures_m, axis=1))),
        time_s=(last_ns - first_ns) * 1e-9,
    )


def _across_m(plan: CoveragePlan, positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distances from the planned path."""
    path = LineString(plan.trajectory.pos_m)
    shapely.prepare(path)
    return np.asarray(shapely.distance(path, shapely.points(positions_m[:, :2])))


def _rms(values: NDArray[np.float64]) -> float:
    return sqrt(float(np.mean(values**2)))


def main() -> None:
    parser = argparse.ArgumentParser(description="How well an area is mapped.")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--resolution", type=float, nargs="+", default=RESOLUTIONS_M)
    arguments = parser.parse_args()
    for resolution_m in arguments.resolution:
        print(f"lines {resolution_m:g} m apart")
        for seed in range(arguments.seeds):
            f = measure(seed, resolution_m)
            print(
                f"  seed {seed}: across the path {100 * f.across_m:.1f} cm RMS (max {100 * f.across_max_m:.1f}, true "
                f"{100 * f.true_across_m:.1f} RMS), height {100 * f.height_m:.1f} cm; {f.pictures} pictures, "
                f"{f.pictures_per_length:.3f} of length/resolution, {100 * f.place_m:.1f} cm from their "
                f"places; covered {100 * f.covered:.2f} % by the path, {100 * f.flown_covered:.1f} % as flown; "
                f"{f.time_s:.0f} s; path {f.length_ratio:.3f} of area/resolution, planned in {f.planning_s:.2f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
