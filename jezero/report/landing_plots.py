"""Figures of one landing: estimate, rover, sensors and odometry against the truth.

Source: thesis Figs 4.5, 4.8, 4.10 to 4.15.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.report.landings import RecordedLanding, Series
from jezero.report.style import (
    BAND,
    ESTIMATE,
    ESTIMATE_BAND,
    GREEN,
    GREY,
    NO_TRUTH,
    TAG,
    TRUTH,
    UWB,
    Format,
    draw,
    legend_above,
    note,
    shade,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXES = ("north", "east", "up")
"""Axes of all figures: those of the log are north, east and down."""
HORIZONTAL = (True, True, False)
GAP_S = 0.25
"""A line is not drawn across a longer time without samples."""
POSITIONS = ("relative", "rover", "uwb", "tag", "uav", "true_relative", "true_rover", "true_uav")
"""Fields of a landing that hold positions."""
BAND_M = 0.1
"""Half the width of the thesis' confidence band."""
ERROR_MAX_M = 0.4
SIGMAS = 3.0
TIME = "time since the landing goal [s]"


def draw_landing(landing: RecordedLanding, directory: Path, suffix: str, form: Format) -> list[Path]:
    """Draw all figures of one landing.

    In a recording without truth, the standard deviations of the filter replace the errors.

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

    landing = _upwards(landing)
    if not landing.by_estimate:
        return [_odometry(landing, file("landing_odometry"))] if len(landing.uav) else []
    files = [
        _relative_position(landing, file("relative_position")),
        _relative_error(landing, file("relative_error")),
    ]
    if len(landing.rover) and (len(landing.uav) or not landing.has_truth):
        draw_rover = _rover_position if landing.has_truth else _rover_estimate
        files.append(draw_rover(landing, file("rover_position")))
    if len(landing.uwb) or len(landing.tag):
        files.append(_uwb_and_tag(landing, file("uwb_tag")))
    return files


def _upwards(landing: RecordedLanding) -> RecordedLanding:
    """The landing with its positions north, east and up, so that a descent goes down in every figure."""
    return replace(landing, **{name: getattr(landing, name).upwards() for name in POSITIONS})


def _relative_position(landing: RecordedLanding, path: Path) -> Path:
    """Draw the relative position, estimated and true (thesis Figs 4.8, 4.10 and 4.13)."""

    def fill(figure: Any, axes: Any) -> None:
        column = axes[:, 0]
        shade(column, landing.phases)
        poor = landing.relative.where(~landing.valid)
        good = landing.relative.where(landing.valid)
        for i, ax in enumerate(column):
            if landing.has_truth:
                _true_with_band(ax, landing.true_relative, i)
            else:
                _estimate_band(ax, good, landing.std[landing.valid][:, i], i)
            if len(poor):
                ax.plot(poor.t_s, poor.values[:, i], ".", ms=1.5, color=GREY, label="estimate, not valid")
            _broken_line(ax, good, i, "estimate")
            ax.set_ylabel(f"{AXES[i]} [m]")
            ax.set_xlim(0.0, landing.end_s)
        if not landing.has_truth:
            note(column[0], NO_TRUTH)
        column[2].set_xlabel(TIME)
        legend_above(figure, column[:1], landing.phases)

    return draw(path, (3, 1), 5.0, fill, sharex=True)


def _relative_error(landing: RecordedLanding, path: Path) -> Path:
    """Draw the errors of the relative position, with the filter's own standard deviations."""

    def fill(figure: Any, axes: Any) -> None:
        column = axes[:, 0]
        shade(column, landing.phases)
        good = landing.relative.where(landing.valid)
        band_cm = 100 * SIGMAS * landing.std[landing.valid]
        error_cm = 100 * (good.values - landing.true_relative.at(good.t_s)) if landing.has_truth else None
        for i, ax in enumerate(column):
            _band(ax)
            t_s, band = _with_gaps(good.t_s, band_cm[:, i])
            ax.fill_between(t_s, -band, band, color=GREEN, alpha=0.15, lw=0)
            for sign in (1, -1):
                label = "±3σ of the filter" if sign > 0 else None
                ax.plot(t_s, sign * band, color=GREEN, lw=0.9, ls="--", label=label)
            if error_cm is not None:
                _broken_line(ax, Series(good.t_s, error_cm), i, "estimate − truth")
            ax.set_ylabel(f"{AXES[i]} [cm]" if landing.has_truth else f"±3σ {AXES[i]} [cm]")
            ax.set_xlim(0.0, landing.end_s)
            _limit(ax, band_cm if error_cm is None else error_cm)
        if not landing.has_truth:
            note(column[0], f"{NO_TRUTH}: the uncertainty of the estimate, not its error")
        column[2].set_xlabel(TIME)
        legend_above(figure, column[:1], landing.phases)

    return draw(path, (3, 1), 5.0, fill, sharex=True, sharey=True)


def _rover_position(landing: RecordedLanding, path: Path) -> Path:
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


def _rover_estimate(landing: RecordedLanding, path: Path) -> Path:
    """Draw the rover's estimated position with its own standard deviation, of a recording without truth."""

    def fill(figure: Any, axes: Any) -> None:
        column = axes[:, 0]
        shade(column, landing.phases)
        valid = landing.rover.values[:, 3] > 0.5
        good, poor = landing.rover.where(valid), landing.rover.where(~valid)
        for i, ax in enumerate(column):
            _estimate_band(ax, good, landing.std_rover[valid], i)
            if len(poor):
                ax.plot(*_column(poor, i), ".", ms=2.5, color=GREY, label="estimate, not valid")
            _broken_line(ax, good, i, "estimate")
            ax.set_ylabel(f"{AXES[i]} [m]")
            ax.set_xlim(0.0, landing.end_s)
            _at_least(ax, 1.0)
        note(column[0], f"{NO_TRUTH}; the band is that of the axis with the greatest standard deviation")
        column[2].set_xlabel(TIME)
        legend_above(figure, column[:1], landing.phases)

    return draw(path, (3, 1), 5.0, fill, sharex=True)


def _uwb_and_tag(landing: RecordedLanding, path: Path) -> Path:
    """Draw the positions from each round of ranges and each image alone, and their errors (thesis Fig. 4.5).

    In a recording without truth, the estimate is the reference.
    """
    reference = landing.true_relative if landing.has_truth else landing.relative.where(landing.valid)
    sensors = [
        (name, series.where(_near(reference, series.t_s)), colour)
        for name, series, colour in (("UWB", landing.uwb, UWB), ("AprilTag", landing.tag, TAG))
    ]

    def fill(figure: Any, axes: Any) -> None:
        shade(axes.flat, landing.phases)
        for i, (left, right) in enumerate(axes):
            if landing.has_truth:
                left.plot(*_column(reference, i), color=TRUTH, lw=0.9, label="truth")
            else:
                _broken_line(left, reference, i, "estimate")
            _band(right)
            rms = []
            for name, series, colour in sensors:
                if not len(series):
                    continue
                error_cm = 100 * (series.values[:, i] - reference.at(series.t_s)[:, i])
                rms.append(f"{name} {np.sqrt(np.mean(error_cm**2)):.1f} cm")
                left.plot(*_column(series, i), ".", ms=2, color=colour, label=name)
                right.plot(series.t_s, error_cm, ".", ms=2, color=colour)
            left.set_ylabel(f"{AXES[i]} [m]")
            right.set_ylabel(f"error {AXES[i]} [cm]" if landing.has_truth else f"difference {AXES[i]} [cm]")
            what = "RMS error" if landing.has_truth else "RMS difference from the estimate"
            right.set_title(f"{what}: {', '.join(rms)}", loc="right", fontsize=7.5, pad=3)
            for ax in (left, right):
                ax.set_xlim(0.0, landing.end_s)
        if not landing.has_truth:
            note(axes[0, 0], NO_TRUTH)
        for ax in axes[2]:
            ax.set_xlabel(TIME)
        legend_above(figure, axes[0], landing.phases, columns=7)

    return draw(path, (3, 2), 5.2, fill, sharex=True)


def _odometry(landing: RecordedLanding, path: Path) -> Path:
    """Draw the odometry of a landing on a spot, and its error on the right (thesis Figs 4.14 and 4.15)."""
    columns = 2 if landing.has_truth else 1

    def fill(figure: Any, axes: Any) -> None:
        shade(axes.flat, landing.phases)
        for i, row in enumerate(axes):
            left = row[0]
            has_std = HORIZONTAL[i] and bool(np.isfinite(landing.std_uav).any())
            if has_std:
                _estimate_band(left, landing.uav, landing.std_uav, i)
            if landing.has_truth:
                left.plot(*_column(landing.true_uav, i), color=TRUTH, lw=0.9, label="truth")
                _odometry_error(row[1], landing, i, has_std=has_std)
            left.plot(*_column(landing.uav, i), color=ESTIMATE, label="vehicle's odometry")
            left.set_ylabel(f"{AXES[i]} [m]")
            for ax in row:
                ax.set_xlim(0.0, landing.end_s)
        for ax in axes[2]:
            ax.set_xlabel(TIME)
        if not landing.has_truth:
            note(axes[0, 0], NO_TRUTH)
        legend_above(figure, axes[0], landing.phases)

    return draw(path, (3, columns), 5.0, fill, sharex=True)


def _odometry_error(ax: "Axes", landing: RecordedLanding, i: int, *, has_std: bool) -> None:
    """Draw the error of the odometry along one axis, which can't be read beside a way of some metres."""
    t_s, values = _column(landing.uav, i)
    error = Series(t_s, 100 * (values - landing.true_uav.at(t_s)[:, i])[:, np.newaxis])
    if has_std:
        band_cm = 100 * SIGMAS * landing.std_uav
        ax.fill_between(t_s, -band_cm, band_cm, color=ESTIMATE_BAND, alpha=0.4, lw=0)
        for sign in (1, -1):
            ax.plot(t_s, sign * band_cm, color=ESTIMATE_BAND, lw=0.9)
    ax.axhline(0.0, color=TRUTH, lw=0.9)
    _broken_line(ax, error, 0, "vehicle's odometry")
    ax.set_ylabel(f"error {AXES[i]} [cm]")


def _column(series: Series, i: int) -> tuple[Array, Array]:
    return series.t_s, series.values[:, i]


def _true_with_band(ax: "Axes", truth: Series, i: int) -> None:
    t_s, values = _column(truth, i)
    ax.fill_between(t_s, values - BAND_M, values + BAND_M, color=BAND, alpha=0.8, lw=0)
    ax.plot(t_s, values, color=TRUTH, lw=0.9, label="truth ±10 cm")


def _band(ax: "Axes") -> None:
    for sign in (1, -1):
        ax.axhline(sign * 100 * BAND_M, color="0.35", lw=0.8, ls=":", label="±10 cm" if sign > 0 else None)


def _estimate_band(ax: "Axes", series: Series, std_m: Array, i: int) -> None:
    """Draw the band of three standard deviations around an estimate."""
    for sign in (-1, 1):  # lines at its edges, because a band of some millimetres can't be seen
        edge = _with_gaps(series.t_s, series.values[:, i] + sign * SIGMAS * std_m)
        ax.plot(*edge, color=ESTIMATE_BAND, lw=0.6, zorder=1.5)
    t_s, low = _with_gaps(series.t_s, series.values[:, i] - SIGMAS * std_m)
    high = _with_gaps(series.t_s, series.values[:, i] + SIGMAS * std_m)[1]
    ax.fill_between(t_s, low, high, color=ESTIMATE_BAND, lw=0, label="±3σ of the estimate")


def _broken_line(ax: "Axes", series: Series, i: int, label: str) -> None:
    """Draw a line with gaps where samples are missing."""
    ax.plot(*_with_gaps(*_column(series, i)), color=ESTIMATE, label=label)


def _with_gaps(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Insert NaN, at which no line is drawn, where samples are missing."""
    gaps = np.flatnonzero(np.diff(t_s) > GAP_S) + 1
    return np.insert(t_s, gaps, np.nan), np.insert(values, gaps, np.nan)


def _near(reference: Series, t_s: Array) -> npt.NDArray[np.bool_]:
    """Whether the reference has a sample near each time, so that its value there is no extrapolation."""
    if not len(reference):
        return np.zeros(len(t_s), dtype=bool)
    after = np.searchsorted(reference.t_s, t_s)
    last = len(reference) - 1
    distances_s = [np.abs(reference.t_s[np.clip(at, 0, last)] - t_s) for at in (after - 1, after)]
    return np.asarray(np.minimum(*distances_s) <= GAP_S)


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
