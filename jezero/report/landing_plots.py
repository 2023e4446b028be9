"""Figures of one landing: estimate, rover, sensors and odometry against the truth.

Source: thesis Figs 4.5, 4.8, 4.10 to 4.15.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jezero.report.landings import Array, Landing, Series
from jezero.report.style import BAND, BLUE, ESTIMATE, GREEN, GREY, ORANGE, TRUTH, Format, draw, legend_above, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXES = ("north", "east", "up")
"""Axes of all figures: those of the log are north, east and down."""
POSITIONS = ("relative", "rover", "uwb", "tag", "uav", "true_relative", "true_rover", "true_uav")
"""Fields of a landing that hold positions."""
BAND_M = 0.1
"""Half the width of the thesis' confidence band."""
ERROR_MAX_M = 0.4
SIGMAS = 3.0
TIME = "time since the landing goal [s]"


def draw_landing(landing: Landing, directory: Path, suffix: str, form: Format) -> list[Path]:
    """Draw all figures of one landing.

    Args:
        landing: the landing.
        directory: folder of the figures.
        suffix: end of the files' names, which distinguishes the landings of a log.
        form: format of the files.
    Returns:
        The files written.
    """

    def file(name: str) -> Path:
        return directory / f"{name}{suffix}.{form}"

    files = []
    landing = _upwards(landing)
    has_truth = len(landing.true_relative) > 1
    if len(landing.relative) and has_truth and landing.by_estimate:
        files.append(_relative_position(landing, file("relative_position")))
        files.append(_relative_error(landing, file("relative_error")))
        if len(landing.rover):
            files.append(_rover_position(landing, file("rover_position")))
    if (len(landing.uwb) or len(landing.tag)) and has_truth and landing.by_estimate:
        files.append(_uwb_and_tag(landing, file("uwb_tag")))
    if not landing.by_estimate and len(landing.uav):
        files.append(_odometry(landing, file("landing_odometry")))
    return files


def _upwards(landing: Landing) -> Landing:
    """The landing with its positions north, east and up, so that a descent goes down in every figure."""
    return replace(landing, **{name: getattr(landing, name).upwards() for name in POSITIONS})


def _relative_position(landing: Landing, path: Path) -> Path:
    """Draw the relative position, estimated and true (thesis Figs 4.8, 4.10 and 4.13)."""

    def fill(figure: Any, axes: Any) -> None:
        column = axes[:, 0]
        shade(column, landing.phases)
        poor = landing.relative.where(~landing.valid)
        good = landing.relative.where(landing.valid)
        for i, ax in enumerate(column):
            _true_with_band(ax, landing.true_relative, i)
            if len(poor):
                ax.plot(poor.t_s, poor.values[:, i], ".", ms=1.5, color=GREY, label="estimate, not valid" * (not i))
            _broken_line(ax, good, i, "estimate")
            ax.set_ylabel(f"{AXES[i]} [m]")
            ax.set_xlim(0.0, landing.end_s)
        column[2].set_xlabel(TIME)
        legend_above(figure, column[:1], landing.phases)

    return draw(path, (3, 1), 5.0, fill, sharex=True)


def _relative_error(landing: Landing, path: Path) -> Path:
    """Draw the errors of the relative position, with the filter's own standard deviations."""

    def fill(figure: Any, axes: Any) -> None:
        column = axes[:, 0]
        shade(column, landing.phases)
        good = landing.relative.where(landing.valid)
        error_m = good.values - landing.true_relative.at(good.t_s)
        std_m = landing.std[landing.valid]
        for i, ax in enumerate(column):
            _band(ax)
            ax.plot(good.t_s, 100 * SIGMAS * std_m[:, i], color=GREEN, lw=0.9, ls="--", label="±3σ of the filter")
            ax.plot(good.t_s, -100 * SIGMAS * std_m[:, i], color=GREEN, lw=0.9, ls="--")
            _broken_line(ax, Series(good.t_s, 100 * error_m), i, "estimate − truth")
            ax.set_ylabel(f"{AXES[i]} [cm]")
            ax.set_xlim(0.0, landing.end_s)
            _limit(ax, 100 * error_m)
        column[2].set_xlabel(TIME)
        legend_above(figure, column[:1], landing.phases)

    return draw(path, (3, 1), 5.0, fill, sharex=True, sharey=True)


def _rover_position(landing: Landing, path: Path) -> Path:
    """Draw the rover's position on the left and its error on the right (thesis Figs 4.11 and 4.12).

    The truth is shifted into the vehicle's world frame by the error of the autopilot's own position, because the
    goal gives the rover's position in that frame.
    """

    def fill(figure: Any, axes: Any) -> None:
        shade(axes.flat, landing.phases)
        t_s = landing.rover.t_s
        shift_m = landing.uav.at(t_s) - landing.true_uav.at(t_s)
        true_m = landing.true_rover.at(t_s) + shift_m
        valid = landing.rover.values[:, 3] > 0.5
        estimate_m = landing.rover.values[:, :3]
        error_m = estimate_m - true_m
        for i, (left, right) in enumerate(axes):
            left.fill_between(t_s, true_m[:, i] - BAND_M, true_m[:, i] + BAND_M, color=BAND, alpha=0.8, lw=0)
            left.plot(t_s, true_m[:, i], color=TRUTH, lw=0.9, label="truth ±10 cm, in the vehicle's world frame")
            _band(right)
            for ax, values in ((left, estimate_m[:, i]), (right, 100 * error_m[:, i])):
                if not valid.all():
                    ax.plot(t_s[~valid], values[~valid], ".", ms=2.5, color=GREY, label="estimate, not valid")
                ax.plot(t_s[valid], values[valid], ".-", ms=2.5, lw=0.9, color=ESTIMATE, label="estimate")
                ax.set_xlim(0.0, landing.end_s)
            left.set_ylabel(f"{AXES[i]} [m]")
            right.set_ylabel(f"error {AXES[i]} [cm]")
            _at_least(left, 1.0)
        for ax in axes[2]:
            ax.set_xlabel(TIME)
        legend_above(figure, axes[0], landing.phases)

    return draw(path, (3, 2), 5.0, fill, sharex=True)


def _uwb_and_tag(landing: Landing, path: Path) -> Path:
    """Draw the positions from each round of ranges and each image alone, and their errors (thesis Fig. 4.5)."""

    def fill(figure: Any, axes: Any) -> None:
        shade(axes.flat, landing.phases)
        start_s = landing.true_relative.t_s[0]
        sensors = [
            (name, series.where(series.t_s >= start_s), colour)
            for name, series, colour in (("UWB", landing.uwb, ORANGE), ("AprilTag", landing.tag, BLUE))
        ]
        for i, (left, right) in enumerate(axes):
            left.plot(*_column(landing.true_relative, i), color=TRUTH, lw=0.9, label="truth")
            _band(right)
            rms = []
            for name, series, colour in sensors:
                if not len(series):
                    continue
                error_m = series.values - landing.true_relative.at(series.t_s)
                rms.append(f"{name} {100 * np.sqrt(np.mean(error_m[:, i] ** 2)):.1f} cm")
                left.plot(*_column(series, i), ".", ms=2, color=colour, label=name)
                right.plot(series.t_s, 100 * error_m[:, i], ".", ms=2, color=colour)
            left.set_ylabel(f"{AXES[i]} [m]")
            right.set_ylabel(f"error {AXES[i]} [cm]")
            right.set_title(f"RMS error: {', '.join(rms)}", loc="right", fontsize=7.5, pad=3)
            for ax in (left, right):
                ax.set_xlim(0.0, landing.end_s)
        for ax in axes[2]:
            ax.set_xlabel(TIME)
        legend_above(figure, axes[0], landing.phases, columns=7)

    return draw(path, (3, 2), 5.2, fill, sharex=True)


def _odometry(landing: Landing, path: Path) -> Path:
    """Draw the odometry of a landing on a spot (thesis Figs 4.14 and 4.15)."""

    def fill(figure: Any, axes: Any) -> None:
        column = axes[:, 0]
        shade(column, landing.phases)
        for i, ax in enumerate(column):
            ax.plot(*_column(landing.uav, i), color=ESTIMATE, label="vehicle's odometry")
            if len(landing.true_uav):
                ax.plot(*_column(landing.true_uav, i), color=TRUTH, lw=0.9, ls=":", label="truth")
            ax.set_ylabel(f"{AXES[i]} [m]")
            ax.set_xlim(0.0, landing.end_s)
        column[2].set_xlabel(TIME)
        legend_above(figure, column[:1], landing.phases)

    return draw(path, (3, 1), 5.0, fill, sharex=True)


def _column(series: Series, i: int) -> tuple[Array, Array]:
    return series.t_s, series.values[:, i]


def _true_with_band(ax: "Axes", truth: Series, i: int) -> None:
    t_s, values = _column(truth, i)
    ax.fill_between(t_s, values - BAND_M, values + BAND_M, color=BAND, alpha=0.8, lw=0)
    ax.plot(t_s, values, color=TRUTH, lw=0.9, label="truth ±10 cm")


def _band(ax: "Axes") -> None:
    for sign in (1, -1):
        ax.axhline(sign * 100 * BAND_M, color="0.35", lw=0.8, ls=":", label="±10 cm" if sign > 0 else None)


def _broken_line(ax: "Axes", series: Series, i: int, label: str) -> None:
    """Draw a line with gaps where samples are missing."""
    t_s, values = series.t_s.copy(), series.values[:, i].copy()
    gaps = np.flatnonzero(np.diff(t_s) > 0.25) + 1
    ax.plot(np.insert(t_s, gaps, np.nan), np.insert(values, gaps, np.nan), color=ESTIMATE, label=label)


def _limit(ax: "Axes", values_cm: Array) -> None:
    """Limit the error axis: not far below the confidence band, and not so far above it that the band is invisible."""
    greatest = float(np.abs(values_cm).max(initial=0.0))
    reach = min(max(1.2 * greatest, 120 * BAND_M), 100 * ERROR_MAX_M)
    ax.set_ylim(-reach, reach)


def _at_least(ax: "Axes", span_m: float) -> None:
    low, high = ax.get_ylim()
    if high - low < span_m:
        middle = 0.5 * (low + high)
        ax.set_ylim(middle - 0.5 * span_m, middle + 0.5 * span_m)
