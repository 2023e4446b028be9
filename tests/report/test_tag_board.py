"""The printed board has the tags where the detector expects them, in true size."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.backends.backend_agg import FigureCanvasAgg

from jezero.base.vehicle_config import PlatformConfig
from jezero.cli.main import main
from jezero.report.tag_board import MARGIN_MM, board_pages, write_board
from jezero.schemas.landing_board import BoardTag

PX_PER_MM = 2.0


def detected(figure: Any) -> dict[int, Any]:
    """Corners of each tag on a page, in mm from its top left."""
    import cv2

    figure.set_dpi(25.4 * PX_PER_MM)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    gray = np.asarray(canvas.buffer_rgba())[:, :, 0].copy()
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, ids, _ = detector.detectMarkers(gray)
    places = (found.reshape(4, 2) for found in corners)
    return {int(each): (place + 0.5) / PX_PER_MM for each, place in zip(ids.flatten(), places, strict=True)}


def test_the_tags_of_the_board_are_where_its_table_says_in_true_size() -> None:
    platform = PlatformConfig()
    (page,) = board_pages(platform, "board")
    found = detected(page)
    middle_mm = MARGIN_MM + 500.0
    seen = [tag for tag in platform.board if tag.tag_id in found]
    assert {77, 1} & {tag.tag_id for tag in seen}
    assert len(seen) > 20
    for tag in seen:
        corners_mm = [(1e3 * right, -1e3 * forward) for forward, right, _ in tag.corners_rover_body_m]
        expected = [(middle_mm + x, middle_mm + y) for x, y in corners_mm]
        assert found[tag.tag_id] == pytest.approx(np.array(expected), abs=1.0)


@pytest.mark.parametrize(("paper", "pages", "width_mm"), [("board", 1, 1036.0), ("a4", 24, 210.0)])
def test_the_pdf_has_pages_of_the_papers_size(tmp_path: Path, paper: Any, pages: int, width_mm: float) -> None:
    file = tmp_path / "tags.pdf"
    assert write_board(file, PlatformConfig(), paper) == pages
    boxes = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", file.read_bytes())
    assert len(boxes) == pages
    assert float(boxes[0][0]) == pytest.approx(width_mm / 25.4 * 72.0, abs=0.1)


def test_a_tile_shows_its_part_of_the_board_in_true_size() -> None:
    tag = BoardTag(tag_id=5, side_m=0.08, pos_rover_body_m=(0.08, -0.08, 0.0))
    pages = list(board_pages(PlatformConfig(side_m=0.3, tags=(tag,)), "a4"))
    assert len(pages) == 4
    left, top = MARGIN_MM + 150.0 - 80.0 - 40.0, MARGIN_MM + 150.0 - 80.0 - 40.0
    expected = [(left, top), (left + 80.0, top), (left + 80.0, top + 80.0), (left, top + 80.0)]
    assert detected(pages[0])[5] == pytest.approx(np.array(expected), abs=1.0)


def test_a_tag_is_drawn_on_each_page_that_it_reaches() -> None:
    tag = BoardTag(tag_id=5, side_m=0.08, pos_rover_body_m=(0.0, 0.0, 0.0))
    pages = list(board_pages(PlatformConfig(side_m=0.3, tags=(tag,)), "a4"))
    shown = [any(patch.get_facecolor() == (0.0, 0.0, 0.0, 1.0) for patch in page.axes[0].patches) for page in pages]
    assert shown == [True, True, False, False]  # 174 mm x 261 mm of the board on each


def test_the_command_names_the_file_and_refuses_another_ending(tmp_path: Path) -> None:
    file = tmp_path / "tags.pdf"
    done = CliRunner().invoke(main, ["tag", "print", "--out", str(file), "--paper", "a3"])
    assert done.exit_code == 0, done.output
    assert "12 pages" in done.output
    refused = CliRunner().invoke(main, ["tag", "print", "--out", str(tmp_path / "tags.png")])
    assert refused.exit_code == 2
    assert "does not end with .pdf" in refused.output
