"""Touchdowns seen from above the platform: one landing with its path, or the scatter of many."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.report.landings import RecordedLanding
from jezero.report.style import BLUE, GREEN, ORANGE, Format, draw, legend_above
from jezero.services.simulator.camera.board import board_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN_M, SCATTER_M = 0.55, 0.22
"""Distance from the platform's centre to the edge of a figure: for one landing, and at least for many."""
PANEL_IN = 3.5
LEGEND_COLUMNS = 3
SIGMAS = 3.0
MARKS_M = {2.0: "o", 0.5: "s"}
"""Heights over the platform that are marked on a path, with their symbols."""


class Touchdowns(NamedTuple):
    """Landings of one kind.

    Attributes:
        title: title of the panel.
        touchdowns_m: (n, 2) forward and right of the platform's centre, or north and east of the spot.
        on_platform: whether these are landings on the rover; else on a spot.
        failed: number of landings without a touchdown.
    """

    title: str
    touchdowns_m: Array
    on_platform: bool = True
    failed: int = 0


def draw_touchdown(landing: RecordedLanding, directory: Path, suffix: str, form: Format) -> list[Path]:
    """Draw one landing's last metres over the platform; no file if it did not end on the platform."""
    place_m = landing.touchdown_rover_body_m
    if place_m is None or not landing.by_estimate or not len(landing.path_rover_body_m):
        return []

    def fill(figure: Any, axes: Any) -> None:
        ax = axes[0, 0]
        _platform(ax, SHOWN_M)
        path_m = landing.path_rover_body_m
        height_m = -path_m[:, 2]
        near = np.flatnonzero(np.abs(path_m[:, :2]).max(axis=1) > 1.0)
        start = int(near[-1]) + 1 if len(near) else 0
        by_whom = "true path" if landing.has_truth else "path by the estimate"
        ax.plot(path_m[start:, 1], path_m[start:, 0], color=BLUE, lw=1.2, label=by_whom)
        for mark_m, symbol in MARKS_M.items():
            above = np.flatnonzero(height_m > mark_m)
            if len(above) and start <= above[-1]:
                forward_m, right_m = path_m[above[-1], 0], path_m[above[-1], 1]
                # In the legend, where labels can't cover each other or the path.
                ax.plot(right_m, forward_m, symbol, ms=4.5, mec="white", mew=0.6, color=BLUE, label=f"{mark_m:g} m up")
        error_cm = 100.0 * float(np.hypot(*place_m))
        if landing.std_touchdown_m is not None:
            _circle(ax, SIGMAS * landing.std_touchdown_m, ORANGE, "--", "3σ of the estimate", place_m)
        ax.plot(
            place_m[1],
            place_m[0],
            "X",
            ms=8,
            zorder=5,
            mec="white",
            mew=0.8,
            color=ORANGE,
            label=f"{'touchdown' if landing.has_truth else 'estimated touchdown'}, {error_cm:.1f} cm",
        )
        legend_above(figure, [ax], columns=LEGEND_COLUMNS if landing.has_truth else LEGEND_COLUMNS - 1)

    return [draw(directory / f"touchdown{suffix}.{form}", (1, 1), PANEL_IN + 0.4, fill, width_in=PANEL_IN)]


def draw_touchdowns(kinds: Sequence[Touchdowns], path: Path) -> Path:
    """Draw the scatter of many landings, one panel for each kind; all panels with a platform have the same scale."""
    on_platform = [float(np.abs(kind.touchdowns_m).max(initial=0.0)) for kind in kinds if kind.on_platform]
    shown_m = max(SCATTER_M, 1.15 * max(on_platform, default=0.0))
    columns = min(len(kinds), 2)
    rows = -(-len(kinds) // columns)

    def fill(figure: Any, axes: Any) -> None:
        for ax, kind in zip(axes.flat, kinds, strict=False):
            _scatter(ax, kind, shown_m)
        for ax in axes.flat[len(kinds) :]:
            ax.set_visible(False)
        legend_above(figure, axes[0, :1])

    return draw(path, (rows, columns), (PANEL_IN + 0.1) * rows + 0.3, fill, width_in=PANEL_IN * columns)


def _scatter(ax: "Axes", kind: Touchdowns, shown_m: float) -> None:
    errors_m = np.hypot(*kind.touchdowns_m.T) if len(kind.touchdowns_m) else np.zeros(0)
    if kind.on_platform:
        _platform(ax, shown_m)
    else:
        _frame(ax, max(SCATTER_M, 1.15 * float(errors_m.max(initial=0.0))), ("north", "east"))
    ax.plot(
        kind.touchdowns_m[:, 1],
        kind.touchdowns_m[:, 0],
        "o",
        ms=4,
        mec="white",
        mew=0.4,
        color=ORANGE,
        label="touchdown",
    )
    total = len(errors_m) + kind.failed
    lines = [f"{kind.title}: {len(errors_m)} of {total} landed"]
    every_m = np.concatenate([errors_m, np.full(kind.failed, np.inf)])
    texts = []
    for share, name, style in ((0.5, "median", "-"), (0.95, "95 %", "--")):
        radius_m = float(np.quantile(every_m, share, method="inverted_cdf")) if total else np.inf
        if np.isfinite(radius_m):
            _circle(ax, radius_m, GREEN, style, name)
            texts.append(f"{name} {100 * radius_m:.1f} cm")
    ax.set_title("\n".join([*lines, ", ".join(texts)]), fontsize=8)


def _platform(ax: "Axes", shown_m: float) -> None:
    """Draw the platform with its tags, the rover's front upwards, and the thesis' circle of 10 cm."""
    platform = load_config(VehicleConfig, "vehicle").platform
    half_m = 0.5 * platform.side_m
    picture = board_picture(platform)[::4, ::4]
    ax.imshow(picture, extent=(-half_m, half_m, -half_m, half_m), alpha=0.22, zorder=0)
    _frame(ax, shown_m, ("forward", "right"))
    _circle(ax, 0.1, "black", ":", "10 cm")


def _frame(ax: "Axes", shown_m: float, names: tuple[str, str]) -> None:
    ax.axhline(0.0, color="0.4", lw=0.5)
    ax.axvline(0.0, color="0.4", lw=0.5)
    ax.set_aspect("equal")
    ax.set_xlim(-shown_m, shown_m)
    ax.set_ylim(-shown_m, shown_m)
    ax.set_ylabel(f"{names[0]} [m]")
    ax.set_xlabel(f"{names[1]} [m]")


def _circle(
    ax: "Axes", radius_m: float, colour: str, style: str, label: str, center_m: tuple[float, float] = (0.0, 0.0)
) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    forward_m, right_m = center_m[0] + radius_m * np.cos(angle), center_m[1] + radius_m * np.sin(angle)
    ax.plot(right_m, forward_m, style, color=colour, lw=1.0, label=label)
