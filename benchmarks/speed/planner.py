"""Time of the coverage planner against the number of corners, holes and lines of an area.

python -m benchmarks.speed.planner [--figure FILE]
"""

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jezero.schemas.goals import AreaCoverageGoal
from jezero.services.actions.area_coverage.area import Point
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.config import ActionsConfig

CORNERS = (30, 100, 300, 1000, 3000)
HOLES = (1, 4, 16, 49, 100)
LINES = (10, 20, 40, 60)


@dataclass(frozen=True)
class Series:
    """Times of plans that differ in one number."""

    name: str
    numbers: tuple[int, ...]
    goal: Callable[[int], AreaCoverageGoal]


def coast(corners: int) -> AreaCoverageGoal:
    """An island of about 110 m with an outline as rough as a coast, and lines 6 m apart."""
    rng = np.random.default_rng(1)
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    waves = np.arange(2, 200)
    rough = (np.sin(np.outer(angles, waves) + rng.uniform(0.0, 2.0 * np.pi, len(waves))) / waves**1.3).sum(axis=1)
    radii_m = 55.0 * (1.0 + 0.25 * rough / np.abs(rough).max())
    return _goal([(r * np.cos(a), r * np.sin(a)) for r, a in zip(radii_m, angles, strict=True)], 6.0)


def field_with_holes(holes: int) -> AreaCoverageGoal:
    """A square of 120 m with square holes of 3 m in rows, and lines 4 m apart."""
    side = round(holes**0.5)
    apart_m = 110.0 / side
    first_m = -0.5 * apart_m * (side - 1) - 1.5
    corners = [(first_m + apart_m * i, first_m + apart_m * j) for i in range(side) for j in range(side)]
    rings = [[(n, e), (n, e + 3.0), (n + 3.0, e + 3.0), (n + 3.0, e)] for n, e in corners]
    return _goal([(-60.0, -60.0), (-60.0, 60.0), (60.0, 60.0), (60.0, -60.0)], 4.0, rings)


def field_with_lines(lines: int) -> AreaCoverageGoal:
    """An L of 120 m with that many lines."""
    return _goal([(0, 0), (0, 120), (48, 120), (48, 48), (120, 48), (120, 0)], 120.0 / lines)


def _goal(corners_m: Iterable[Point], resolution_m: float, holes_m: Iterable[list[Point]] = ()) -> AreaCoverageGoal:
    return AreaCoverageGoal(
        polygon_ned_m=tuple((float(n), float(e)) for n, e in corners_m),
        holes_ned_m=tuple(tuple(hole) for hole in holes_m),
        z_ned_m=-8.0,
        resolution_m=resolution_m,
        force=True,
    )


SERIES = (
    Series("corners", CORNERS, coast),
    Series("holes", HOLES, field_with_holes),
    Series("lines", LINES, field_with_lines),
)


def plan_time_s(goal: AreaCoverageGoal) -> float:
    """Processor time of one plan."""
    begin_s = time.process_time()
    plan_coverage(goal, ActionsConfig())
    return time.process_time() - begin_s


def draw(times_s: dict[str, list[float]], path: Path) -> None:
    """A figure of the times, both axes logarithmic."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    for series in SERIES:
        axes.loglog(series.numbers, times_s[series.name], "o-", label=series.name)
    axes.axhline(3.0, color="0.6", linewidth=1.0, linestyle="--")
    axes.text(1.0, 3.2, "required: 3 s", ha="left", va="bottom", color="0.4")
    axes.set_xlabel("number of corners, holes or lines")
    axes.set_ylabel("processor time of a plan (s)")
    axes.set_ylim(top=6.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.grid(which="major", color="0.9")
    axes.legend(frameon=False, loc="lower right")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print the times, and draw them if a file is given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", type=Path, help="draw the times into this file")
    arguments = parser.parse_args()
    plan_time_s(field_with_lines(5))  # imports
    times_s: dict[str, list[float]] = {}
    for series in SERIES:
        times_s[series.name] = [plan_time_s(series.goal(number)) for number in series.numbers]
        for number, seconds in zip(series.numbers, times_s[series.name], strict=True):
            print(f"{number:5d} {series.name:8} {seconds:6.2f} s")
    if arguments.figure is not None:
        draw(times_s, arguments.figure)


if __name__ == "__main__":
    main()
