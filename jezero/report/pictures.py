"""Figures of images: the places where they were taken, and a contact sheet (thesis Figs 3.10 and 3.12)."""

from collections.abc import Sequence
from math import ceil, cos, sin, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from jezero.frames import altitude_m, quat_rotate
from jezero.recording import Entry
from jezero.report.style import BLUE, GREY, ORANGE, WIDTH_IN, Format, draw
from jezero.schemas import topics
from jezero.schemas.images import LISTING, Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHEET_MAX = 24
"""Highest number of images on a sheet; of more, this many are chosen evenly."""
ASIDE_M = 0.35
"""Distance of the images' numbers from the circle, outwards."""


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
    feedback_topic = topics.feedback_of(topics.GET_IMAGES).name
    feedback = [entry.message for entry in entries if entry.topic == feedback_topic]
    odometry = [entry.message for entry in entries if entry.topic == topics.ODOMETRY.name]
    files = []
    for number, goal_id in enumerate(dict.fromkeys(message.goal_id for message in feedback), 1):
        own = [message for message in feedback if message.goal_id == goal_id]
        images = [image for message in own for image in message.feedback.images]
        flown = [o.pos_uav_ned_m for o in odometry if own[0].t_ns <= o.t_ns <= own[-1].t_ns]
        if images and flown:
            name = "orbit" if number == 1 else f"orbit_{number}"
            files.append(_draw_orbit(folder / f"{name}.{form}", np.array(flown), images))
    return files


def _draw_orbit(path: Path, track_ned_m: Any, images: Sequence[Image]) -> Path:
    def fill(figure: Any, axes: Any) -> None:
        above, beside = axes[0]
        _from_above(above, track_ned_m, images)
        beside.plot(track_ned_m[:, 1], [altitude_m(z) for z in track_ned_m[:, 2]], color=BLUE)
        positions_m = [image.pos_uav_ned_m for image in images]
        beside.plot([m[1] for m in positions_m], [altitude_m(m[2]) for m in positions_m], "o", color=ORANGE, ms=4)
        beside.set_xlabel("east [m]")
        beside.set_ylabel("height [m]")
        beside.set_ylim(0.0, max(1.25 * altitude_m(float(track_ned_m[:, 2].min())), 1.0))
        beside.margins(x=0.1)
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=4)

    return draw(path, (1, 2), 3.6, fill, width_ratios=(1.5, 1.0))


def _from_above(ax: "Axes", track_ned_m: Any, images: Sequence[Image]) -> None:
    """Draw the path north up, with the viewing direction of each image."""
    positions_m = np.array([image.pos_uav_ned_m for image in images])
    views = np.array([quat_rotate(image.q_ned_from_camera, (0.0, 0.0, 1.0)) for image in images])
    ax.plot(track_ned_m[:, 1], track_ned_m[:, 0], color=BLUE, label="flown")
    ax.plot(track_ned_m[0, 1], track_ned_m[0, 0], "s", color=GREY, ms=5, label="start")
    ax.plot(positions_m[:, 1], positions_m[:, 0], "o", color=ORANGE, ms=4, label="pictures", zorder=4)
    ax.quiver(
        *(positions_m[:, 1], positions_m[:, 0], views[:, 1], views[:, 0]),
        angles="xy", scale_units="xy", scale=1.0, width=0.004, color=ORANGE, alpha=0.7,
    )  # fmt: skip
    for image, (north_m, east_m, _) in zip(images, positions_m, strict=True):
        outwards = image.yaw_rad + np.pi
        place = (east_m + ASIDE_M * sin(outwards), north_m + ASIDE_M * cos(outwards))
        ax.plot(*place, alpha=0.0)  # so that the axes include the numbers
        ax.annotate(str(image.index + 1), place, ha="center", va="center", fontsize=7)
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.12)


def draw_contact_sheet(folder: Path, form: Format) -> list[Path]:
    """Draw a dataset's images on one sheet, each with its number; no file without images."""
    taken = read_dataset(folder)
    if not taken:
        return []
    chosen = [
        taken[i] for i in np.unique(np.linspace(0, len(taken) - 1, min(len(taken), SHEET_MAX)).round().astype(int))
    ]
    rows = max(1, round(sqrt(len(chosen) * 3 / 4)))
    columns = ceil(len(chosen) / rows)

    def fill(figure: Any, axes: Any) -> None:
        from PIL import Image as Pillow

        for ax in axes.flat:
            ax.set_axis_off()
        for ax, picture in zip(axes.flat, chosen, strict=False):
            with Pillow.open((folder / LISTING).parent / picture.file) as opened:
                ax.imshow(np.asarray(opened))
            ax.set_title(str(picture.index + 1), pad=2)

    return [draw(folder / f"contact_sheet.{form}", (rows, columns), 0.95 * WIDTH_IN * 0.75 * rows / columns, fill)]
