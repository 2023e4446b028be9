"""Figures of area coverages: the planned path and the flown one (thesis Figs 3.12, 3.14 to 3.16)."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Vec3
from jezero.report.style import BLUE, GREEN, GREY, ORANGE, PINK, WIDTH_IN, Format, draw
from jezero.schemas.actions import PlannedCoverage
from jezero.schemas.fence import Fence
from jezero.schemas.goals import AreaCoverageGoal, Frame
from jezero.schemas.images import LISTING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from shapely.geometry import Polygon

    from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan

GROUND, EDGE = "#efe6db", "0.25"
ARROWS = 6


class _Image(msgspec.Struct, frozen=True):
    pos_uav_ned_m: tuple[float, float, float]


class _Dataset(msgspec.Struct, frozen=True):
    """Fields of a coverage's dataset that are drawn."""

    images: list[_Image]
    goal: AreaCoverageGoal | None = None
    track_ned_m: list[Vec3] = []
    earlier_tracks_ned_m: list[list[Vec3]] = []
    track_frame: Frame = "world"


def draw_plan(path: Path, area: "Polygon", plan: PlannedCoverage, title: str, fence: Fence | None = None) -> None:
    """Draw a plan, north up, with the fence in force where the plan is in the world frame."""
    path_m, pictures_m = np.array(plan.path_ned_m), np.array(plan.pictures_ned_m)

    def fill(figure: Any, axes: Any) -> None:
        ax = axes[0, 0]
        _area(ax, area)
        if fence is not None:
            _fence(ax, fence)
        ax.plot(path_m[:, 1], path_m[:, 0], color=BLUE, label="path")
        _places(ax, pictures_m, f"{len(pictures_m)} pictures")
        ax.plot(*path_m[0, ::-1], "o", color=GREEN, ms=6, label="start", zorder=4)
        ax.set_title(title)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)

    path.parent.mkdir(parents=True, exist_ok=True)
    draw(path, (1, 1), WIDTH_IN, fill)


def draw_coverage(folder: Path, form: Format) -> list[Path]:
    """Draw a coverage's dataset: the planned path, the flown path and the places of the images.

    Returns:
        The file written, if the folder has the dataset of a coverage.

    Raises:
        msgspec.DecodeError: `images.json` is invalid.
        AreaError: its goal can't be planned with the present settings.
    """
    from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
    from jezero.services.actions.config import load_actions_config

    try:
        dataset = msgspec.json.decode((folder / LISTING).read_bytes(), type=_Dataset)
    except FileNotFoundError:
        return []
    if dataset.goal is None or not dataset.images:
        return []
    tracks_ned_m = [*dataset.earlier_tracks_ned_m, dataset.track_ned_m]
    tracks_m = [np.array(track, dtype=float).reshape(-1, 3)[:, :2] for track in tracks_ned_m if track]
    plan = plan_coverage(dataset.goal, load_actions_config(), tracks_m[0][0] if tracks_m else None)
    taken_m = np.array([image.pos_uav_ned_m[:2] for image in dataset.images], dtype=float)
    if dataset.goal.frame == "rover":  # images have world positions: the frame's origin follows from the difference
        taken_m = taken_m - np.median(taken_m - plan.pictures_m[: len(taken_m)], axis=0)
    if dataset.track_frame != dataset.goal.frame:
        tracks_m = []
    return [_draw_flown(folder / f"coverage.{form}", plan, dataset.goal.frame, tracks_m, taken_m)]


def _draw_flown(path: Path, plan: "CoveragePlan", frame: Frame, tracks_m: list[Array], taken_m: Array) -> Path:
    def fill(figure: Any, axes: Any) -> None:
        planned, flown = axes[0]
        for ax in (planned, flown):
            _area(ax, plan.area)
        planned.plot(plan.trajectory.pos_m[:, 1], plan.trajectory.pos_m[:, 0], color=BLUE, lw=0.9)
        _places(planned, plan.pictures_m, "")
        planned.plot(*plan.trajectory.pos_m[0, ::-1], "o", color=GREEN, ms=5, zorder=4)
        planned.plot(*plan.trajectory.pos_m[-1, ::-1], "s", color=GREEN, ms=5, zorder=4)
        _direction(planned, plan.trajectory.pos_m)
        length_m, covered = plan.trajectory.length_m, 100.0 * plan.covered
        planned.set_title(f"planned: {length_m:.0f} m, {len(plan.pictures_m)} pictures, {covered:.1f} % covered")
        flown.plot(plan.trajectory.pos_m[:, 1], plan.trajectory.pos_m[:, 0], color=GREY, lw=0.6, label="planned path")
        for track_m in tracks_m:
            flown.plot(track_m[:, 1], track_m[:, 0], color=BLUE, lw=0.9)
        flown.plot([], [], color=BLUE, lw=0.9, label="flown path")
        _places(flown, taken_m, "pictures")
        flown.plot([], [], "o", color=GREEN, ms=5, label="start of the path")
        flown.plot([], [], "s", color=GREEN, ms=5, label="end of the path")
        flown.set_title(f"flown: {len(taken_m)} pictures{_off_text(plan, tracks_m)}")
        if frame == "rover":
            for ax in (planned, flown):
                ax.set_xlabel("east of the platform's centre [m]")
            planned.set_ylabel("north of the platform's centre [m]")
        flown.set_ylabel("")  # that of the left axes, whose scale it shares
        figure.legend(*flown.get_legend_handles_labels(), loc="outside lower center", ncols=5)

    north_m, east_m = np.ptp(plan.trajectory.pos_m, axis=0)
    height_in = float(np.clip(0.5 * WIDTH_IN * (north_m + 1.0) / (east_m + 1.0), 2.2, 9.0)) + 0.6
    return draw(path, (1, 2), height_in, fill, sharex=True, sharey=True)


def _off_text(plan: "CoveragePlan", tracks_m: list[Array]) -> str:
    """Text with the distances of the newest flight from the planned path, after it was reached."""
    if not tracks_m:
        return ""
    import shapely
    from shapely.geometry import LineString

    track_m = tracks_m[-1]
    off_m = shapely.distance(LineString(plan.trajectory.pos_m), shapely.points(track_m))
    start_m = np.linalg.norm(track_m - plan.trajectory.pos_m[0], axis=1)
    on_it = off_m[int(np.argmin(start_m)) :]
    return f", {100.0 * float(np.sqrt(np.mean(on_it**2))):.1f} cm RMS from the path"


def _direction(ax: "Axes", path_m: Array) -> None:
    """Draw arrows along a path."""
    along_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path_m, axis=0), axis=1))))
    for share in np.arange(0.5, ARROWS) / ARROWS:
        at = min(int(np.searchsorted(along_m, share * along_m[-1])), len(path_m) - 2)
        ax.annotate(
            "", xy=(path_m[at + 1, 1], path_m[at + 1, 0]), xytext=(path_m[at, 1], path_m[at, 0]),
            arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 0.9, "mutation_scale": 9.0},
        )  # fmt: skip


def _area(ax: "Axes", area: "Polygon") -> None:
    for number, ring in enumerate((area.exterior, *area.interiors)):
        corners = np.array(ring.coords)
        ax.fill(corners[:, 1], corners[:, 0], facecolor="white" if number else GROUND, edgecolor=EDGE, lw=0.9)
    ax.set_aspect("equal")
    ax.margins(0.05)
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")


def _fence(ax: "Axes", fence: Fence) -> None:
    """Draw the zone to stay in as an outline, and those to stay out of hatched."""
    for zone in fence.zones:
        corners = np.array(zone.corners_ned_m)
        keep_in = zone is fence.keep_in
        style: dict[str, Any] = {"fill": False, "edgecolor": PINK, "lw": 1.2}
        ax.fill(corners[:, 1], corners[:, 0], hatch=None if keep_in else "///", label=zone.name, **style)


def _places(ax: "Axes", positions_m: Array, label: str) -> None:
    """Draw the places of images; the more there are, the smaller."""
    size = float(np.clip(1500.0 / max(len(positions_m), 1), 1.5, 16.0))
    ax.scatter(positions_m[:, 1], positions_m[:, 0], s=size, color=ORANGE, zorder=3, linewidths=0, label=label or None)
