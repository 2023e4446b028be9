"""The calibration board: ChArUco, as OpenCV knows it, and its print on A4 in true size."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array

COLUMNS, ROWS = 5, 7
SQUARE_MM = 38.0
MARKER_SHARE = 28.0 / 38.0
"""Side of a marker by that of a square: with whole millimetres each of its 7 cells is 4 mm."""
PIXELS_PER_MM = 10
PAGE_MM = (210.0, 297.0)
RULER_MM = 100
CORNERS_MIN = 8
"""Fewer corners of the board say too little."""
MM_PER_INCH = 25.4


@dataclass(frozen=True)
class View:
    """The corners of the board in one picture.

    Attributes:
        object_m: (n, 3) corners on the board.
        corners_px: (n, 2) the same corners in the picture.
    """

    object_m: Array
    corners_px: Array


class Board:
    """A board of `COLUMNS` x `ROWS` squares.

    Args:
        square_m: side of a square, as measured on the print.
    """

    def __init__(self, square_m: float = 1e-3 * SQUARE_MM) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
        self._board = cv2.aruco.CharucoBoard((COLUMNS, ROWS), square_m, MARKER_SHARE * square_m, dictionary)
        self._detector = cv2.aruco.CharucoDetector(self._board)
        self.size_m = (COLUMNS * square_m, ROWS * square_m)

    def find(self, grey: npt.NDArray[np.uint8]) -> View | None:
        """The board in a grey picture; None where too little of it is seen."""
        corners, ids, _, _ = self._detector.detectBoard(grey)
        if corners is None or ids is None or len(ids) < CORNERS_MIN:
            return None
        match: Any = self._board.matchImagePoints  # its stubs ask for a sequence of arrays
        object_m, corners_px = match(corners, ids)
        if object_m is None or len(object_m) < CORNERS_MIN:
            return None
        return View(np.asarray(object_m, float).reshape(-1, 3), np.asarray(corners_px, float).reshape(-1, 2))

    def picture(self, pixels_per_square: int) -> npt.NDArray[np.uint8]:
        """The board from straight above, without a margin."""
        size_px = (COLUMNS * pixels_per_square, ROWS * pixels_per_square)
        return np.asarray(self._board.generateImage(size_px, marginSize=0, borderBits=1), np.uint8)

    def write_pdf(self, path: Path) -> None:
        """Write the board as a page of A4 in true size, with a ruler to check the print.

        Raises:
            OSError: the file can't be written.
        """
        from matplotlib.figure import Figure

        figure = Figure(figsize=(PAGE_MM[0] / MM_PER_INCH, PAGE_MM[1] / MM_PER_INCH))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(0.0, PAGE_MM[0])
        axes.set_ylim(0.0, PAGE_MM[1])
        axes.set_axis_off()
        width_mm, height_mm = COLUMNS * SQUARE_MM, ROWS * SQUARE_MM
        left_mm, bottom_mm = 0.5 * (PAGE_MM[0] - width_mm), PAGE_MM[1] - height_mm - 8.0
        place = (left_mm, left_mm + width_mm, bottom_mm, bottom_mm + height_mm)
        picture = self.picture(round(PIXELS_PER_MM * SQUARE_MM))
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255, extent=place, interpolation="none", aspect="auto")
        ruler_mm = bottom_mm - 5.0
        axes.plot((left_mm, left_mm + RULER_MM), (ruler_mm, ruler_mm), color="black", linewidth=0.5)
        for at_mm in range(0, RULER_MM + 1, 5):
            length_mm = 3.0 if at_mm % 10 == 0 else 1.5
            axes.plot((left_mm + at_mm,) * 2, (ruler_mm, ruler_mm + length_mm), color="black", linewidth=0.5)
        text = (
            f"This line is {RULER_MM} mm, and each square {SQUARE_MM:g} mm, where it is printed in true size (100 %, "
            "not fitted to the page).\nGlue the sheet on something flat."
        )
        axes.text(left_mm, ruler_mm - 1.5, text, fontsize=7, verticalalignment="top")
        axes.set_xlim(0.0, PAGE_MM[0])
        axes.set_ylim(0.0, PAGE_MM[1])
        figure.savefig(path, format="pdf")
