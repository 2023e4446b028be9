"""The guidance: which views are kept, and what is said to be missing."""

import numpy as np
import pytest

from jezero.calibration.board import Board, View
from jezero.calibration.guide import Guide, summary_of
from jezero.calibration.intrinsics import CameraIntrinsics
from tests.calibration.views import SIZE_PX

CAMERA = CameraIntrinsics(SIZE_PX, (500.0, 500.0), (319.5, 239.5), "plumb_bob", (0.0,) * 5)


def view(
    at_px: tuple[float, float] = (0.0, 0.0), away_m: float = 0.8, right_deg: float = 0.0, down_deg: float = 0.0
) -> View:
    """The board with its middle at a place from the picture's middle; tilts: its left, and its upper side nearer."""
    width_m, height_m = Board().size_m
    points = np.array([(x, y) for y in np.linspace(-0.4, 0.4, 6) for x in np.linspace(-0.4, 0.4, 4)])
    points_m = points * (width_m, height_m)
    depth_m = np.tan(np.radians(right_deg)) * points_m[:, 0] + np.tan(np.radians(down_deg)) * points_m[:, 1]
    # Shorter across where it is tilted, so that it stays the same board.
    x_m, y_m = points_m[:, 0] * np.cos(np.radians(right_deg)), points_m[:, 1] * np.cos(np.radians(down_deg))
    depth_m = depth_m * np.cos(np.radians(right_deg)) * np.cos(np.radians(down_deg))
    middle_m = np.array(at_px) * away_m / 500.0
    corners = np.column_stack((x_m + middle_m[0], y_m + middle_m[1])) / (away_m + depth_m)[:, None]
    return View(np.column_stack((points_m, np.zeros(len(points_m)))), 500.0 * corners + np.array(CAMERA.center_px))


def show(guide: Guide, shown: View) -> bool:
    """Hold a view still for three pictures; whether it was kept."""
    kept = [guide.update(shown) for _ in range(3)]
    return any(kept)


def test_the_summary_says_where_the_board_is_and_how_it_is_tilted() -> None:
    summary = summary_of(view((100.0, -60.0), right_deg=25.0), SIZE_PX)
    assert summary.place == pytest.approx((0.5 + 100 / 640, 0.5 - 60 / 480), abs=0.04)
    assert summary.tilt_right_deg == pytest.approx(25.0, abs=6.0)
    assert abs(summary.tilt_down_deg) < 5.0
    assert summary_of(view(down_deg=-25.0), SIZE_PX).tilt_down_deg < -15.0
    assert summary_of(view(away_m=0.4), SIZE_PX).size > 1.7 * summary_of(view(away_m=0.8), SIZE_PX).size


def test_a_view_is_kept_once_and_a_moving_board_is_not() -> None:
    guide = Guide(SIZE_PX)
    assert show(guide, view())
    assert not show(guide, view())
    assert not guide.update(view((60.0, 0.0)))
    assert not guide.update(view((150.0, 0.0)))
    assert guide.said.startswith("hold the board still")
    assert guide.update(view((150.0, 0.0)))
    assert len(guide.views) == 2


def test_no_board_is_named() -> None:
    guide = Guide(SIZE_PX)
    assert not guide.update(None)
    assert guide.said.startswith("the board is not seen")


def test_who_does_what_is_said_gets_all_covered() -> None:
    guide = Guide(SIZE_PX)
    steps = {"left": -150.0, "middle": 0.0, "right": 150.0}, {"top": -110.0, "middle": 0.0, "bottom": 110.0}
    instructions = []
    for number in range(60):
        if guide.done:
            break
        said = guide.missing
        instructions.append(said)
        words = said.split()
        if said.startswith("move the board to the middle of"):
            show(guide, view())
        elif said.startswith("move the board to"):
            show(guide, view((steps[0][words[6]], steps[1][words[5]])))
        elif said.startswith("tilt the board: its"):
            sides = {"left": (30.0, 0.0), "right": (-30.0, 0.0), "upper": (0.0, 30.0), "lower": (0.0, -30.0)}
            right_deg, down_deg = sides[words[4]]
            show(guide, view(right_deg=right_deg, down_deg=down_deg))
        elif "closer" in said:
            show(guide, view(away_m=0.4))
        elif "away from" in said:
            show(guide, view(away_m=1.2))
        else:
            turn = 0.7 * number
            show(guide, view((160.0 * np.cos(turn), 120.0 * np.sin(turn)), right_deg=25 * np.sin(3 * turn)))
    assert guide.done, instructions
    assert len(guide.views) >= 20
    assert "tilt the board: its left side (in the picture) towards the camera" in instructions
    assert "move the board closer to the camera" in instructions
