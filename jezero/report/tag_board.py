"""The tag board of `vehicle.toml` as a PDF in true size, on one page or on tiles to be glued together."""

from collections.abc import Iterator
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jezero.base.files import naming
from jezero.base.vehicle_config import PlatformConfig
from jezero.schemas.landing_board import CELLS, BoardTag

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Paper = Literal["board", "a4", "a3"]
PAPERS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0)}
"""Width and height of the paper."""
MARGIN_MM = 18.0
"""Around the board's part on each page, for the ruler and for what printers leave white."""
RULER_MM = 100
MM_PER_IN = 25.4


def write_board(path: Path, platform: PlatformConfig, paper: Paper) -> int:
    """Write the board; returns the number of pages.

    Raises:
        OSError: the file can't be written; the error names it.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    count = 0
    with naming(path), PdfPages(path) as pages:
        for page in board_pages(platform, paper):
            pages.savefig(page)
            count += 1
    return count


def board_pages(platform: PlatformConfig, paper: Paper) -> Iterator["Figure"]:
    """The pages, from the front left of the board to the right, then further back."""
    side_mm = 1e3 * platform.side_m
    width_mm, height_mm = PAPERS_MM.get(paper, (side_mm + 2 * MARGIN_MM,) * 2)
    across_mm, along_mm = width_mm - 2 * MARGIN_MM, height_mm - 2 * MARGIN_MM
    columns, rows = ceil(side_mm / across_mm - 1e-9), ceil(side_mm / along_mm - 1e-9)
    for row in range(rows):
        for column in range(columns):
            left_mm, front_mm = -0.5 * side_mm + column * across_mm, 0.5 * side_mm - row * along_mm
            part = (
                left_mm,
                min(left_mm + across_mm, 0.5 * side_mm),
                max(front_mm - along_mm, -0.5 * side_mm),
                front_mm,
            )
            label = f"row {row + 1} of {rows}, column {column + 1} of {columns}; the rover's nose is up"
            yield _page(platform, (width_mm, height_mm), part, label)


def _page(
    platform: PlatformConfig, size_mm: tuple[float, float], part_mm: tuple[float, float, float, float], label: str
) -> "Figure":
    """One page with a part of the board.

    Args:
        part_mm: left, right, back and front edge of the part, from the board's middle.
    """
    from matplotlib.figure import Figure

    width_mm, height_mm = size_mm
    left, right, back, front = part_mm
    figure = Figure(figsize=(width_mm / MM_PER_IN, height_mm / MM_PER_IN))
    across, along = (right - left) / width_mm, (front - back) / height_mm
    axes = figure.add_axes((MARGIN_MM / width_mm, 1.0 - MARGIN_MM / height_mm - along, across, along))
    axes.set(xlim=(left, right), ylim=(back, front), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(linewidth=0.3, color="#999999")
    for tag in platform.board:
        _draw_tag(axes, tag, part_mm)
    _draw_ruler(figure.add_axes((MARGIN_MM / width_mm, 0.0, RULER_MM / width_mm, 0.6 * MARGIN_MM / height_mm)))
    about = f"jezero tag board, {label}"
    figure.text(MARGIN_MM / width_mm, 1.0 - 0.7 * MARGIN_MM / height_mm, about, fontsize=7, color="#555555")
    return figure


def _draw_tag(axes: "Axes", tag: BoardTag, part_mm: tuple[float, float, float, float]) -> None:
    """Draw a tag with its white margin over what is there; one that lies outside the page's part is left out."""
    cell_mm = 1e3 * tag.side_m / CELLS
    forward_mm, right_mm = 1e3 * tag.pos_rover_body_m[0], 1e3 * tag.pos_rover_body_m[1]
    half_mm = 0.5 * cell_mm * (CELLS + 2)
    left_mm, top_mm = right_mm - half_mm, forward_mm + half_mm
    left, right, back, front = part_mm
    if left_mm >= right or right_mm + half_mm <= left or top_mm <= back or forward_mm - half_mm >= front:
        return
    _fill(axes, left_mm, top_mm, 2 * half_mm, 2 * half_mm, "white")
    for row, cells in enumerate(_cells(tag.tag_id), 1):
        start = 0
        while start < CELLS:  # cells of one colour in a row are one rectangle, so that no line shows between them
            stop = start
            while stop < CELLS and cells[stop] == cells[start]:
                stop += 1
            if not cells[start]:
                width_mm = (stop - start) * cell_mm
                _fill(axes, left_mm + (start + 1) * cell_mm, top_mm - row * cell_mm, width_mm, cell_mm, "black")
            start = stop


def _fill(axes: "Axes", left_mm: float, top_mm: float, width_mm: float, height_mm: float, color: str) -> None:
    from matplotlib.patches import Rectangle

    corner = (left_mm, top_mm - height_mm)
    axes.add_patch(Rectangle(corner, width_mm, height_mm, facecolor=color, linewidth=0.0, antialiased=False))


def _cells(tag_id: int) -> list[list[bool]]:
    """Whether each cell of the tag's black square is white, rows from the top."""
    import cv2

    dictionary: Any = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return [[value > 0 for value in row] for row in cv2.aruco.generateImageMarker(dictionary, tag_id, CELLS).tolist()]


def _draw_ruler(axes: "Axes") -> None:
    """A ruler of 100 mm, to check that the printer has not scaled the page."""
    axes.set(xlim=(0, RULER_MM), ylim=(0, 10))
    axes.axis("off")
    axes.plot((0, RULER_MM), (9, 9), color="black", linewidth=0.6, clip_on=False)
    for at_mm in range(0, RULER_MM + 1, 10):
        axes.plot((at_mm, at_mm), (9, 6 if at_mm % 50 == 0 else 7.5), color="black", linewidth=0.6, clip_on=False)
    axes.text(0, 3, "this line is 100 mm long: print without scaling (100 %)", fontsize=7, color="#333333")
