"""Plots of a whole flight: position and status code over time (thesis Figs 3.5 and 3.6)."""

from collections.abc import Sequence
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jezero.base.frames import Vec3, altitude_m
from jezero.recording import Entry
from jezero.report.style import BLUE, GREEN, GREY, ORANGE, TRUTH, Format, draw
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (BLUE, ORANGE, GREEN)
SIGMAS = 3.0
NOWHERE: Vec3 = (nan, nan, nan)
SETPOINT_GAP_S = 0.5
SHORT_SHARE = 0.01
"""A status code that lasts for a smaller share of the flight has a mark, because its bar can hardly be seen."""
WORDS = {
    StatusCode.IDLE: "idle",
    StatusCode.TAKEOFF: "takeoff",
    StatusCode.TAKEOFF_DONE: "takeoff completed",
    StatusCode.HOVER: "hover",
    StatusCode.GO_TO: "go to target",
    StatusCode.GO_TO_DONE: "target reached",
    StatusCode.GET_IMAGES: "get images",
    StatusCode.GET_IMAGES_DONE: "images taken",
    StatusCode.LANDING: "landing",
    StatusCode.LANDING_DONE: "landed",
    StatusCode.COVERAGE: "area coverage",
    StatusCode.COVERAGE_DONE: "area covered",
    StatusCode.ABORT: "abort",
    StatusCode.EXTERNAL: "under other command",
    StatusCode.ACTION: "other action",
    StatusCode.ACTION_DONE: "other action completed",
}


def draw_flight(entries: Sequence[Entry], directory: Path, form: Format) -> list[Path]:
    """Draw position and status of a flight.

    Returns:
        The files written.

    Raises:
        ValueError: the log has no status or odometry to draw.
    """
    status = [e.message for e in entries if e.topic == topics.STATUS.name]
    if not status or not any(e.topic == topics.ODOMETRY.name for e in entries):
        raise ValueError("it holds no flight: it has no status or no odometry")
    return [
        _draw(directory / f"position.{form}", 3.3, lambda axes: _position(axes, entries)),
        _draw(directory / f"status.{form}", 2.6, lambda axes: _status(axes, status)),
    ]


def _draw(path: Path, height_in: float, fill: Any) -> Path:
    def fill_figure(figure: Any, axes: Any) -> None:
        ax = axes[0, 0]
        fill(ax)
        ax.set_xlabel("vehicle time [s]")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=5, columnspacing=1.3)

    return draw(path, (1, 1), height_in, fill_figure)


def _position(axes: "Axes", entries: Sequence[Entry]) -> None:
    odometry = [e.message for e in entries if e.topic == topics.ODOMETRY.name]
    truth = [e.message for e in entries if e.topic == topics.TRUTH.name]
    setpoint_s, setpoint_m = _position_setpoints([e.message for e in entries if e.topic == topics.SETPOINT.name])
    for axis, (name, colour) in enumerate(zip(("north", "east", "altitude"), COLOURS, strict=True)):
        axes.plot(_times(odometry), [upwards(m.pos_uav_ned_m)[axis] for m in odometry], color=colour, label=name)
        if axis < 2 and not truth:
            _uncertainty(axes, odometry, axis, colour)
        true_m = [upwards(m.pos_uav_ned_m)[axis] for m in truth]
        axes.plot(
            _times(truth), true_m, ":", color=TRUTH, lw=0.9, label="true position" if truth and axis == 2 else None
        )
        wanted_m = [upwards(m)[axis] for m in setpoint_m]
        axes.plot(
            setpoint_s,
            wanted_m,
            "--",
            color=GREY,
            lw=1.0,
            label="position setpoints" if setpoint_m and axis == 2 else None,
        )
    axes.set_ylabel("position in the world frame [m]")


def _uncertainty(axes: "Axes", odometry: Sequence[Any], axis: int, colour: str) -> None:
    """Draw the band of three standard deviations around a horizontal position, of a recording without truth."""
    known = [(m.t_ns / NS_PER_S, m.pos_uav_ned_m[axis], SIGMAS * m.std_pos_m) for m in odometry if m.std_pos_m]
    if known:
        times_s, values_m, bands_m = zip(*known, strict=True)
        low_m = [value_m - band_m for value_m, band_m in zip(values_m, bands_m, strict=True)]
        high_m = [value_m + band_m for value_m, band_m in zip(values_m, bands_m, strict=True)]
        axes.fill_between(times_s, low_m, high_m, color=colour, alpha=0.2, lw=0.0, label="±3σ" if axis == 1 else None)


def upwards(pos_ned_m: Vec3) -> Vec3:
    """North, east and altitude: a climb goes up in every figure."""
    return (pos_ned_m[0], pos_ned_m[1], altitude_m(pos_ned_m[2]))


def _position_setpoints(setpoints: Sequence[Any]) -> tuple[list[float], list[Vec3]]:
    """Times and points of position setpoints; NaN at velocity setpoints and gaps, where no line is drawn."""
    times_s: list[float] = []
    points_m: list[Vec3] = []
    for t_s, setpoint in zip(_times(setpoints), setpoints, strict=True):
        if times_s and t_s - times_s[-1] > SETPOINT_GAP_S:
            times_s.append(t_s)
            points_m.append(NOWHERE)
        times_s.append(t_s)
        points_m.append(setpoint.pos_ned_m or NOWHERE)
    return times_s, points_m


def _status(axes: "Axes", status: Sequence[Any]) -> None:
    """Draw a row for each code that occurs, with a bar while it lasts; a short one is a mark, so that it is visible."""
    times_s = _times(status)
    present = sorted({m.code for m in status})
    row_of = {code: row for row, code in enumerate(present)}
    axes.set_yticks(range(len(present)), [f"{WORDS[StatusCode(code)]}  {code}" for code in present])
    axes.step(times_s, [row_of[m.code] for m in status], where="post", color=BLUE, lw=0.7, alpha=0.5)
    short_s = SHORT_SHARE * (times_s[-1] - times_s[0])
    for number, (code, begin_s, end_s) in enumerate(code_spans(status)):
        row, label = row_of[code], "status code" if number == 0 else None
        axes.plot((begin_s, end_s), (row, row), color=BLUE, lw=5.0, solid_capstyle="butt", label=label)
        if end_s - begin_s < short_s:
            axes.plot(0.5 * (begin_s + end_s), row, "|", color=BLUE, ms=6.0, mew=2.0)
    top = len(present) - 0.4
    armed = [top if m.armed else -0.6 for m in status]
    axes.fill_between(times_s, -0.6, armed, step="post", alpha=0.07, color="0.3", lw=0.0, label="armed")
    axes.set_ylim(-0.6, top)
    axes.margins(x=0.01)


def code_spans(status: Sequence[Any]) -> list[tuple[int, float, float]]:
    """Code, begin and end in seconds of each span of one code; it ends where the next begins."""
    times_s = _times(status)
    changes = [i for i, message in enumerate(status) if i == 0 or status[i - 1].code != message.code]
    return [(status[i].code, times_s[i], times_s[j]) for i, j in pairwise((*changes, len(status) - 1))]


def _times(messages: Sequence[Any]) -> list[float]:
    return [m.t_ns / NS_PER_S for m in messages]
