"""Plots of a flight: position and status code over time (thesis Figs 3.5 and 3.6)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jezero.report.flight_log import Entry, read_log
from jezero.schemas import topics
from jezero.schemas.state import StatusCode

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NS_PER_S = 1e9
COLOURS = ("#1f77b4", "#d95f02", "#2a9d5c")
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
}


def draw_flight(log: Path, directory: Path, title: str) -> list[Path]:
    """Draw a log's plots as PNG files into a directory.

    Returns:
        The files written: `position.png` and `status.png`.

    Raises:
        ValueError: the log has no status or odometry to draw.
    """
    entries = list(read_log(log))
    status = [e.message for e in entries if e.topic == topics.STATUS.name]
    if not status or not any(e.topic == topics.ODOMETRY.name for e in entries):
        raise ValueError(f"{log} holds no flight: it has no status or no odometry")
    directory.mkdir(parents=True, exist_ok=True)
    return [
        _draw(directory / "position.png", title, lambda axes: _position(axes, entries)),
        _draw(directory / "status.png", title, lambda axes: _status(axes, status)),
    ]


def _draw(path: Path, title: str, fill: Any) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots()
    fill(axes)
    axes.set_title(title)
    axes.set_xlabel("vehicle time [s]")
    axes.grid(True, alpha=0.3)
    axes.margins(x=0.01)
    figure.savefig(path, dpi=130)
    return path


def _position(axes: "Axes", entries: Sequence[Entry]) -> None:
    odometry = [e.message for e in entries if e.topic == topics.ODOMETRY.name]
    truth = [e.message for e in entries if e.topic == topics.TRUTH.name]
    setpoints = [e.message for e in entries if e.topic == topics.SETPOINT.name and e.message.pos_ned_m is not None]
    for axis, (name, colour) in enumerate(zip(("x north", "y east", "z down"), COLOURS, strict=True)):
        axes.plot(_times(odometry), [m.pos_uav_ned_m[axis] for m in odometry], color=colour, label=name)
        axes.plot(_times(truth), [m.pos_uav_ned_m[axis] for m in truth], ":", color=colour, lw=1, alpha=0.8)
        axes.plot(_times(setpoints), [m.pos_ned_m[axis] for m in setpoints], "--", color=colour, lw=1, alpha=0.6)
    axes.plot([], [], ":", color="0.4", lw=1, label="true position")
    axes.plot([], [], "--", color="0.4", lw=1, label="position setpoints")
    axes.set_ylabel("position in the world frame, NED [m]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)


def _status(axes: "Axes", status: Sequence[Any]) -> None:
    times = _times(status)
    codes = [m.code for m in status]
    axes.step(times, codes, where="post", color=COLOURS[0], label="status code")
    present = sorted(set(codes))
    axes.set_yticks(present, [f"{WORDS[StatusCode(code)]}  {code}" for code in present])
    axes.set_ylabel("status code")
    axes.fill_between(
        times, 0, [max(present) if m.armed else 0 for m in status], step="post", alpha=0.07, color="0.3", label="armed"
    )
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)


def _times(messages: Sequence[Any]) -> list[float]:
    return [m.t_ns / NS_PER_S for m in messages]
