"""Figure of the innovations of each sensor with the spread that the filter predicts, and of their consistency.

Source: thesis Fig. 4.5 compares UWB and tag to choose R; here each sensor is compared with the filter's prediction.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.report.style import BAND, BLUE, GREEN, GREY, ORANGE, draw, legend_above
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.innovations import Innovation
from jezero.tuning.sensors import SENSORS
from jezero.tuning.tuner import SensorTuning, TuningResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SIGMAS = 2.0
GAP_S = 1.0
"""A band is not drawn across a longer time without measurements."""
PAUSE_S = 2.0
"""Space between two flights."""
QUANTILE_SHOWN, MARGIN, BAND_MAX = 0.99, 1.4, 3.0
"""The axes show this share of the innovations, with a margin, and of the bands what lies within a multiple of it."""
ROW_IN, HEAD_IN = 1.25, 0.9
NIS_LIMITS = (0.02, 50.0)


class _Series(NamedTuple):
    """Innovations of one sensor in all flights, one flight after the other.

    Attributes:
        t_s: (n,) times.
        std: (n,) predicted standard deviations, the root of the mean over the components.
        dots_s: (k,) times of all components.
        residual: (k,) innovations of all components.
        accepted: (k,) whether the gate accepts them.
    """

    t_s: Array
    std: Array
    dots_s: Array
    residual: Array
    accepted: npt.NDArray[np.bool_]


def draw_tuning(result: TuningResult, path: Path) -> Path:
    """Draw the sensors that have a setting; the suffix of `path` gives the format."""
    shown = [each for each in result.sensors if each.suggestion is not None] or result.sensors
    starts = _starts(result)

    def fill(figure: Any, axes: Any) -> None:
        for tuning, (left, right) in zip(shown, axes, strict=True):
            in_use = _series([flight.innovations[tuning.sensor] for flight in result.flights_in_use], starts)
            suggested = _series([flight.innovations[tuning.sensor] for flight in result.flights_suggested], starts)
            _draw_innovations(left, tuning, in_use, suggested)
            _draw_nis(right, tuning)
            for _, offset_s in starts[1:]:
                left.axvline(offset_s - 0.5 * PAUSE_S, color="0.4", lw=0.8)
        for number, (_, offset_s) in enumerate(starts, start=1):
            axes[0, 0].annotate(
                f"flight {number}", (offset_s, 1.0), xycoords=("data", "axes fraction"), xytext=(2, 3),
                textcoords="offset points", fontsize=7.5, color="0.3",
            )  # fmt: skip
        axes[0, 1].set_title("NIS and its 95 % band", fontsize=7.5, color="0.3", pad=3)
        axes[-1, 0].margins(x=0.01)
        axes[-1, 0].set_xlabel("time of the flights, one after the other [s]")
        axes[-1, 1].set_xlabel("NIS (1 is consistent)")
        legend_above(figure, axes[:, 0])

    height_in = ROW_IN * len(shown) + HEAD_IN
    return draw(path, (len(shown), 2), height_in, fill, sharex="col", width_ratios=(4.5, 1.0))


def _starts(result: TuningResult) -> list[tuple[float, float]]:
    """Vehicle time of the first innovation of each flight in seconds, and where the flight begins in the figure."""
    starts: list[tuple[float, float]] = []
    offset_s = 0.0
    for flight in result.flights_in_use:
        times_ns = [each.t_ns for series in flight.innovations.values() for each in series] or [0]
        starts.append((min(times_ns) / NS_PER_S, offset_s))
        offset_s += (max(times_ns) - min(times_ns)) / NS_PER_S + PAUSE_S
    return starts


def _series(flights: Sequence[Sequence[Innovation]], starts: Sequence[tuple[float, float]]) -> _Series:
    times_s: list[float] = []
    innovations: list[Innovation] = []
    for flight, (first_s, offset_s) in zip(flights, starts, strict=True):
        times_s += [each.t_ns / NS_PER_S - first_s + offset_s for each in flight]
        innovations += flight
    sizes = [len(each.residual) for each in innovations]
    return _Series(
        t_s=np.array(times_s),
        std=np.sqrt([each.cov.trace() / len(each.residual) for each in innovations]),
        dots_s=np.repeat(times_s, sizes),
        residual=np.concatenate([np.empty(0), *(each.residual for each in innovations)]),
        accepted=np.concatenate([np.empty(0, bool), *(each.accepted for each in innovations)]),
    )


def _draw_innovations(ax: "Axes", tuning: SensorTuning, in_use: _Series, suggested: _Series) -> None:
    """Draw the innovations with the settings in use, and the predicted bands with both."""
    info = SENSORS[tuning.sensor]
    t_s, half = _band(in_use, info.per_si)
    ax.fill_between(t_s, -half, half, color=BAND, alpha=0.7, lw=0, label="±2σ predicted with the settings in use")
    fits = in_use.accepted
    ax.plot(in_use.dots_s[fits], info.per_si * in_use.residual[fits], ".", ms=2.2, color=BLUE, alpha=0.7, mew=0)
    ax.plot([], [], ".", ms=6, color=BLUE, label="innovation")  # dots as small as in the axes vanish in the legend
    if not fits.all():
        ax.plot(in_use.dots_s[~fits], info.per_si * in_use.residual[~fits], "x", ms=2.5, mew=0.6, color=ORANGE)
        ax.plot([], [], "x", ms=4, color=ORANGE, label="rejected by the gate")
    t_s, half = _band(suggested, info.per_si)
    for sign in (1, -1):
        ax.plot(t_s, sign * half, color=GREEN, lw=0.9, label="±2σ with the suggestions" if sign > 0 else None)
    ax.axhline(0.0, color="0.3", lw=0.5)
    reach = info.per_si * float(np.quantile(np.abs(in_use.residual), QUANTILE_SHOWN))
    bands = SIGMAS * info.per_si * max(float(np.median(each.std)) for each in (in_use, suggested) if len(each.std))
    limit = MARGIN * max(reach, min(bands, BAND_MAX * reach))
    ax.set_ylim(-limit, limit)
    ax.set_ylabel(f"{tuning.label}\n[{info.unit}]", fontsize=7.5)


def _band(series: _Series, per_si: float) -> tuple[Array, Array]:
    """Times and half the width of the predicted band, with a break in each gap."""
    breaks = np.flatnonzero(np.diff(series.t_s) > GAP_S) + 1
    middles_s = series.t_s[breaks] - 0.5 * GAP_S
    return np.insert(series.t_s, breaks, middles_s), np.insert(SIGMAS * per_si * series.std, breaks, np.nan)


def _draw_nis(ax: "Axes", tuning: SensorTuning) -> None:
    """Draw NIS with the settings in use and with the suggestions."""
    rows = ((1.0, tuning.in_use, GREY, "in use"), (0.0, tuning.suggested, GREEN, "suggested"))
    for y, consistency, color, name in rows:
        if consistency is None:
            continue
        ax.plot(consistency.nis_band, (y, y), color="0.6", lw=9, solid_capstyle="butt", zorder=1)
        nis = consistency.nis
        inside = None if nis is None else min(max(nis, NIS_LIMITS[0]), NIS_LIMITS[1])
        text = "all rejected" if nis is None else f"{nis:.2f}"
        if inside is not None:
            ax.plot([inside], [y], "o", ms=4, color=color, zorder=3)
        ax.annotate(
            f"{name} {text}", (0.04, y + 0.3), xycoords=("axes fraction", "data"), fontsize=6.5, color=color,
            va="center", bbox={"facecolor": "white", "lw": 0, "pad": 0.5}, zorder=4,
        )  # fmt: skip
    ax.axvline(1.0, color="0.6", lw=0.6, zorder=0)
    ax.set_xscale("log")
    ax.set_xlim(*NIS_LIMITS)
    ax.set_ylim(-0.5, 1.7)
    ax.set_yticks([])
