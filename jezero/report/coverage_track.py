"""Figures of area coverages from a recording: the flown path with its pictures, and how well the position is known."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jezero.recording import Entry
from jezero.report.flown_goals import FlownGoal, flown_goals
from jezero.report.style import (
    ESTIMATE,
    FLOWN,
    GREEN,
    NO_TRUTH,
    PICTURES,
    TRUTH,
    WIDTH_IN,
    Format,
    draw,
    legend_above,
    note,
)
from jezero.schemas import topics
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIGMAS = 3.0


def draw_coverage_tracks(entries: Sequence[Entry], folder: Path, form: Format) -> list[Path]:
    """Draw each coverage of a log, from above and with the error of the vehicle's own position over time."""
    files: list[Path] = []
    for flown in flown_goals(entries, topics.AREA_COVERAGE):
        name = f"coverage_track_{len(files) + 1}" if files else "coverage_track"
        files.append(_draw(folder / f"{name}.{form}", flown))
    return files


def _draw(path: Path, flown: FlownGoal) -> Path:
    track_m = np.array([odometry.pos_uav_ned_m for odometry in flown.odometry])

    def fill(figure: Any, axes: Any) -> None:
        above, beside = axes[0]
        _from_above(above, flown, track_m)
        _position_error(beside, flown, track_m)
        legend_above(figure, axes[0])

    north_m, east_m = np.ptp(track_m[:, :2], axis=0)
    height_in = float(np.clip(0.5 * WIDTH_IN * (north_m + 1.0) / (east_m + 1.0), 2.4, 6.0)) + 0.6
    return draw(path, (1, 2), height_in, fill)


def _from_above(ax: "Axes", flown: FlownGoal, track_m: Any) -> None:
    if flown.truth:
        true_m = np.array([truth.pos_uav_ned_m for truth in flown.truth])
        ax.plot(true_m[:, 1], true_m[:, 0], ":", color=TRUTH, lw=0.9, label="truth")
    ax.plot(track_m[:, 1], track_m[:, 0], color=FLOWN, label="flown, by odometry")
    if flown.images:
        taken_m = np.array([image.pos_uav_ned_m for image in flown.images])
        ax.plot(taken_m[:, 1], taken_m[:, 0], "o", color=PICTURES, ms=3.5, mew=0.0, zorder=4, label="pictures")
    ax.plot(*track_m[0, 1::-1], "s", color=GREEN, ms=5, zorder=5, label="start")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.06)
    length_m = float(np.linalg.norm(np.diff(track_m[:, :2], axis=0), axis=1).sum())
    note(ax, f"{flown.pictures_text}, {length_m:.0f} m flown")


def _position_error(ax: "Axes", flown: FlownGoal, track_m: Any) -> None:
    """Draw the horizontal error of the odometry, by which the vehicle flies, and its own standard deviation."""
    start_ns = flown.odometry[0].t_ns
    t_s = np.array([(odometry.t_ns - start_ns) / NS_PER_S for odometry in flown.odometry])
    if flown.truth:
        true_s = np.array([(truth.t_ns - start_ns) / NS_PER_S for truth in flown.truth])
        true_m = np.array([truth.pos_uav_ned_m for truth in flown.truth])
        off_m = [track_m[:, axis] - np.interp(t_s, true_s, true_m[:, axis]) for axis in (0, 1)]
        error_m = np.hypot(*off_m)
        ax.plot(t_s, 100.0 * error_m, color=ESTIMATE, label="odometry − truth")
        note(ax, f"horizontal error of the odometry: RMS {100.0 * float(np.sqrt(np.mean(error_m**2))):.0f} cm")
    else:
        note(ax, f"{NO_TRUTH}: uncertainty, not error")
    known = [(at_s, o.std_pos_m) for at_s, o in zip(t_s, flown.odometry, strict=True) if o.std_pos_m is not None]
    if known:
        band_s, std_m = np.array(known).T
        # An area, because the standard deviation saws at the rate of GNSS, which a dashed line makes illegible.
        ax.fill_between(band_s, 100.0 * SIGMAS * std_m, color=GREEN, alpha=0.2, lw=0.0, label="3σ of the odometry")
    ax.set_xlabel("time since the start [s]")
    ax.set_ylabel("position error [cm]" if flown.truth else "3σ of the position [cm]")
    ax.set_ylim(0.0, 1.15 * ax.get_ylim()[1])
