"""Figures of images: the places where they were taken, and a contact sheet (thesis Figs 3.10 and 3.12)."""

from collections.abc import Sequence
from math import ceil, cos, sin, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from jezero.base.frames import altitude_m, quat_rotate
from jezero.recording import Entry
from jezero.report.flown_goals import FlownGoal, flown_goals
from jezero.report.style import FLOWN, GREEN, PICTURES, WIDTH_IN, Format, draw, note
from jezero.schemas import topics
from jezero.schemas.images import LISTING
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHEET_MAX = 24
"""Highest number of images on a sheet; of more, this many are chosen evenly."""
ASIDE_M = 0.35
"""Distance of the images' numbers from the circle, outwards."""
SIGHT_MAX_M = 20.0
"""Longest line of sight that is drawn; one that looks to the horizon has no end."""


class DatasetImage(msgspec.Struct, frozen=True):
    """Fields of a dataset's image that are drawn; its file is in the folder of the list."""

    file: str
    index: int


class _Dataset(msgspec.Struct, frozen=True):
    images: list[DatasetImage]


def read_dataset(folder: Path) -> list[DatasetImage]:
    """Read the list of a folder's images; empty without a list.

    Raises:
        msgspec.DecodeError: `images.json` is not a dataset's.
    """
    try:
        data = (folder / LISTING).read_bytes()
    except FileNotFoundError:
        return []
    return msgspec.json.decode(data, type=_Dataset).images


def draw_orbits(entries: Sequence[Entry], folder: Path, form: Format) -> list[Path]:
    """Draw each orbit of a log from above: the flown path and the places of the images."""
    files: list[Path] = []
    for flown in flown_goals(entries, topics.GET_IMAGES):
        name = f"orbit_{len(files) + 1}" if files else "orbit"
        files.append(_draw_orbit(folder / f"{name}.{form}", flown))
    return files


def _draw_orbit(path: Path, flown: FlownGoal) -> Path:
    track, images = flown.odometry, flown.images
    start_ns = track[0].t_ns

    def fill(figure: Any, axes: Any) -> None:
        above, beside = axes[0]
        _from_above(above, flown)
        heights_m = [altitude_m(odometry.pos_uav_ned_m[2]) for odometry in track]
        beside.plot([(odometry.t_ns - start_ns) / NS_PER_S for odometry in track], heights_m, color=FLOWN)
        for image in images:
            place = ((image.t_ns - start_ns) / NS_PER_S, altitude_m(image.pos_uav_ned_m[2]))
            beside.plot(*place, "o", color=PICTURES, ms=4)
            beside.annotate(str(image.index + 1), place, (0, 6), textcoords="offset points", ha="center", fontsize=7)
        beside.set_xlabel("time since the goal [s]")
        beside.set_ylabel("height [m]")
        beside.set_ylim(0.0, max(1.25 * max(heights_m), 1.0))
        beside.margins(x=0.03)
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=5)

    return draw(path, (1, 2), 3.6, fill, width_ratios=(1.2, 1.0))


def _from_above(ax: "Axes", flown: FlownGoal) -> None:
    """Draw the path north up, with the line of sight of each image as far as the ground."""
    track_ned_m = np.array([odometry.pos_uav_ned_m for odometry in flown.odometry])
    images = flown.images
    ax.plot(track_ned_m[:, 1], track_ned_m[:, 0], color=FLOWN, label="flown")
    ax.plot(track_ned_m[0, 1], track_ned_m[0, 0], "s", color=GREEN, ms=5, label="start")
    note(
        ax, f"{len(images)} of {flown.planned} pictures" if images else f"{flown.planned} pictures, not in the feedback"
    )
    for number, image in enumerate(images):
        north_m, east_m, down_m = image.pos_uav_ned_m
        view = quat_rotate(image.q_ned_from_camera, (0.0, 0.0, 1.0))
        length_m = min(-down_m / view[2], SIGHT_MAX_M) if view[2] > 0.0 and down_m < 0.0 else SIGHT_MAX_M
        aim = (east_m + length_m * view[1], north_m + length_m * view[0])
        sight, middle = ("line of sight", "middle of the picture, at height 0") if number == 0 else (None, None)
        ax.plot((east_m, aim[0]), (north_m, aim[1]), color=PICTURES, lw=0.8, alpha=0.7, label=sight)
        ax.plot(*aim, "+", color=PICTURES, ms=7, label=middle)
        outwards = image.yaw_rad + np.pi
        place = (east_m + ASIDE_M * sin(outwards), north_m + ASIDE_M * cos(outwards))
        ax.plot(*place, alpha=0.0)  # so that the axes include the numbers
        ax.annotate(
            str(image.index + 1), place, ha="center", va="center", fontsize=7,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
        )  # fmt: skip
    positions_m = np.array([image.pos_uav_ned_m for image in images], dtype=float).reshape(-1, 3)
    ax.plot(
        positions_m[:, 1], positions_m[:, 0], "o", color=PICTURES, ms=4, label="pictures" if images else None, zorder=4
    )
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.12)


def draw_contact_sheet(folder: Path, form: Format) -> list[Path]:
    """Draw a dataset's images on one sheet, each with its number; no file without images."""
    from PIL import Image as Pillow

    taken = read_dataset(folder)
    if not taken:
        return []
    chosen = [
        taken[i] for i in np.unique(np.linspace(0, len(taken) - 1, min(len(taken), SHEET_MAX)).round().astype(int))
    ]
    rows = max(1, round(sqrt(len(chosen) * 3 / 4)))
    columns = ceil(len(chosen) / rows)

    def fill(figure: Any, axes: Any) -> None:
        figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.0, hspace=0.0)
        for ax in axes.flat:
            ax.set_axis_off()
        for ax, picture in zip(axes.flat, chosen, strict=False):
            with Pillow.open((folder / LISTING).parent / picture.file) as opened:
                ax.imshow(np.asarray(opened))
            ax.text(
                0.02, 0.97, str(picture.index + 1), transform=ax.transAxes, ha="left", va="top", fontsize=7,
                bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8},
            )  # fmt: skip

    with Pillow.open((folder / LISTING).parent / chosen[0].file) as first:
        aspect = first.height / first.width
    return [draw(folder / f"contact_sheet.{form}", (rows, columns), WIDTH_IN * aspect * rows / columns, fill)]
