"""A plan of an area coverage, drawn: area, path, pictures (thesis Fig. 3.14)."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from shapely.geometry import Polygon


def draw_plan(path: Path, area: "Polygon", path_ned_m: Any, pictures_ned_m: Any, title: str) -> None:
    """Write a PNG, north up.

    Args:
        path_ned_m, pictures_ned_m: (n, 2) north and east.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 8), layout="constrained")
    axes = figure.subplots()
    for number, ring in enumerate((area.exterior, *area.interiors)):
        north_m, east_m = np.array(ring.coords).T
        axes.fill(east_m, north_m, facecolor="white" if number else "#efe6db", edgecolor="0.25", lw=1.2)
    north_m, east_m = np.asarray(path_ned_m).T
    axes.plot(east_m, north_m, color="#1f77b4", lw=1.4, label="path")
    north_m, east_m = np.asarray(pictures_ned_m).T
    size = float(np.clip(3000.0 / max(len(north_m), 1), 3.0, 30.0))
    axes.scatter(east_m, north_m, s=size, color="#d95f02", zorder=3, label=f"{len(north_m)} pictures")
    axes.plot(*np.asarray(path_ned_m)[0][::-1], "o", color="#2a9d5c", ms=9, label="start")
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.set_title(title)
    axes.grid(True, alpha=0.25)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
