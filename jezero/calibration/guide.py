"""Guidance of a person who shows the board to the camera: which views there are, and which one is missing."""

from dataclasses import dataclass
from math import atan, degrees

import cv2
import numpy as np

from jezero.base.arrays import Array
from jezero.calibration.board import View

GRID = 3
"""The picture is covered when the board has been in each of these cells, of three columns and three rows."""
NEAR_MIN, FAR_MAX = 0.35, 0.22
"""Size of the board's inner corners in the picture, as the root of their part of the area: 0.48 where the upright board
fills the height of a picture of 4 by 3."""
TILT_MIN_DEG = 20.0
VIEWS_MIN = 20
STILL_MAX_PX = 1.5
"""Movement of the corners between two pictures above which the picture may be blurred."""
NEW_MIN = 0.12
"""A view adds something when its place, its size or its tilts (by 90 degrees) differ by this from each other view's."""
COLUMN_WORDS, ROW_WORDS = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass(frozen=True)
class ViewSummary:
    """What a view adds.

    Attributes:
        place: middle of the corners, as fractions of the picture's width and height.
        size: root of the part of the picture that the corners enclose.
        tilt_right_deg: how far the board is turned: positive, its left side is nearer.
        tilt_down_deg: positive, its upper side is nearer.
        cells: cells of the grid that have corners in them.
    """

    place: tuple[float, float]
    size: float
    tilt_right_deg: float
    tilt_down_deg: float
    cells: frozenset[tuple[int, int]]

    def differs_from(self, other: "ViewSummary") -> bool:
        """Whether one of the two adds something to the other."""
        return (
            abs(self.place[0] - other.place[0]) > NEW_MIN
            or abs(self.place[1] - other.place[1]) > NEW_MIN
            or abs(self.size - other.size) > NEW_MIN
            or abs(self.tilt_right_deg - other.tilt_right_deg) > 90.0 * NEW_MIN
            or abs(self.tilt_down_deg - other.tilt_down_deg) > 90.0 * NEW_MIN
        )


def summary_of(view: View, size_px: tuple[int, int]) -> ViewSummary:
    """What a view adds, with a rough guess of the focal length."""
    width_px, height_px = size_px
    corners_px = view.corners_px
    hull = cv2.convexHull(corners_px.astype(np.float32))
    x, y = corners_px.mean(axis=0)
    columns = np.clip(GRID * corners_px[:, 0] / width_px, 0, GRID - 1).astype(int)
    rows = np.clip(GRID * corners_px[:, 1] / height_px, 0, GRID - 1).astype(int)
    right_deg, down_deg = _tilts_deg(view, size_px)
    return ViewSummary(
        place=(float(x) / width_px, float(y) / height_px),
        size=float(np.sqrt(cv2.contourArea(hull) / (width_px * height_px))),
        tilt_right_deg=right_deg,
        tilt_down_deg=down_deg,
        cells=frozenset(zip(columns.tolist(), rows.tolist(), strict=True)),
    )


def _tilts_deg(view: View, size_px: tuple[int, int]) -> tuple[float, float]:
    """How much farther the board's right and lower sides are than the others, as angles."""
    guess = np.array(
        ((0.8 * size_px[0], 0.0, 0.5 * size_px[0]), (0.0, 0.8 * size_px[0], 0.5 * size_px[1]), (0.0, 0.0, 1.0))
    )
    solved, turn, place = cv2.solvePnP(view.object_m, view.corners_px, guess, np.zeros(5))
    if not solved:
        return 0.0, 0.0
    points_m: Array = view.object_m @ cv2.Rodrigues(turn)[0].T + np.ravel(place)
    across = np.column_stack((points_m[:, :2], np.ones(len(points_m))))
    slope_x, slope_y, _ = np.linalg.lstsq(across, points_m[:, 2], rcond=None)[0]
    return degrees(atan(float(slope_x))), degrees(atan(float(slope_y)))


class Guide:
    """Decides which pictures are kept, and says what to do next.

    Args:
        size_px: width and height of the pictures.

    Attributes:
        views: the views that are kept.
        said: what to do now, for people.
    """

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.views: list[View] = []
        self.said = "show the board to the camera"
        self._size_px = size_px
        self._summaries: list[ViewSummary] = []
        self._last: View | None = None

    def update(self, view: View | None) -> bool:
        """Take in the view of the next picture; returns whether it is kept."""
        last, self._last = self._last, view
        if view is None:
            self.said = f"the board is not seen: show it to the camera, whole and well lit; {self.missing or 'done'}"
            return False
        summary = summary_of(view, self._size_px)
        adds = all(summary.differs_from(other) for other in self._summaries)
        if adds and (last is None or not _is_still(last, view)):
            self.said = f"hold the board still; {self.missing}"
            return False
        if adds:
            self.views.append(view)
            self._summaries.append(summary)
        self.said = self.missing or "all is covered"
        return adds

    @property
    def done(self) -> bool:
        """Whether the views determine the camera well."""
        return not self.missing

    @property
    def missing(self) -> str:
        """What is missing next, as an instruction; "" when nothing is."""
        seen = set().union(*(summary.cells for summary in self._summaries)) if self._summaries else set()
        for row in (1, 0, 2):
            for column in (1, 0, 2):
                if (column, row) not in seen:
                    where = "middle" if (column, row) == (1, 1) else f"{ROW_WORDS[row]} {COLUMN_WORDS[column]}"
                    return f"move the board to the {where} of the picture"
        tilts = (
            (max(s.tilt_right_deg for s in self._summaries) >= TILT_MIN_DEG, "left"),
            (min(s.tilt_right_deg for s in self._summaries) <= -TILT_MIN_DEG, "right"),
            (max(s.tilt_down_deg for s in self._summaries) >= TILT_MIN_DEG, "upper"),
            (min(s.tilt_down_deg for s in self._summaries) <= -TILT_MIN_DEG, "lower"),
        )
        for covered, side in tilts:
            if not covered:
                return f"tilt the board: its {side} side (in the picture) towards the camera"
        if max(s.size for s in self._summaries) < NEAR_MIN:
            return "move the board closer to the camera"
        if min(s.size for s in self._summaries) > FAR_MAX:
            return "move the board away from the camera"
        if len(self.views) < VIEWS_MIN:
            return "tilt and move the board anew, towards the picture's edges"
        return ""


def _is_still(last: View, view: View) -> bool:
    """Whether the corners that both views have are where they were."""
    places = {tuple(point): corner for point, corner in zip(last.object_m.tolist(), last.corners_px, strict=True)}
    moves = [
        float(np.hypot(*(corner - places[tuple(point)])))
        for point, corner in zip(view.object_m.tolist(), view.corners_px, strict=True)
        if tuple(point) in places
    ]
    return bool(moves) and float(np.median(moves)) <= STILL_MAX_PX
