"""A map that grows with each image of a coverage, for a look during the flight; `jezero map` makes the exact one.

Each image is projected on level ground by the vehicle's own estimate, and each pixel of the map shows the image whose
camera was nearest. Nothing is aligned, so that an image costs some milliseconds.
"""

from dataclasses import dataclass
from math import ceil, floor
from statistics import median

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.base.frames import quat_rotate
from jezero.base.lens import undistorted_picture
from jezero.schemas.images import Image

Pixels = NDArray[np.uint8]
PIXELS_MAX = 1_500_000
"""A map with more pixels is reduced to half its resolution, as often as needed."""
COARSER = 1.5
"""Metres per pixel of a new map, relative to those of its first image."""
STEP_PX = 64
"""The map grows by this number of pixels, so that it does not grow with each image."""
DOWN_MIN = 0.94
"""Least cosine between the camera's axis and straight down, of an image that is used."""
GROUND_KEPT = 30
"""The ground's height is the median by the altimeter at the last images."""
WEBP_QUALITY = 70


@dataclass(frozen=True)
class MapPlace:
    """Where a picture of the map lies in the world.

    Attributes:
        north_m: north of its upper edge.
        east_m: east of its left edge.
        height_m: extent to the south.
        width_m: extent to the east.
    """

    north_m: float
    east_m: float
    height_m: float
    width_m: float


class GrowingMap:
    """The map of one goal's images.

    Attributes:
        count: number of images in it.
    """

    def __init__(self) -> None:
        self.count = 0
        self._m_per_px = 0.0
        self._row0, self._column0 = 0, 0
        """Number of the first row and column, counted from the world's origin to the south and to the east."""
        self._colours: Pixels = np.zeros((0, 0, 4), np.uint8)
        self._away_m2 = np.zeros((0, 0), np.float32)
        """Squared horizontal distance from the camera that each pixel shows; infinite where none does."""
        self._grounds_m: list[float] = []

    def add(self, image: Image, pixels: bytes) -> bool:
        """Add an image; returns False for one that looks to the side, which is left out."""
        axes = [quat_rotate(image.q_ned_from_camera, axis) for axis in ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))]
        rotation = np.array(axes).T
        if rotation[2, 2] < DOWN_MIN or image.focal_px <= 0.0:
            return False
        ground_m = self._ground_m(image, float(rotation[2, 2]))
        height_m = ground_m - image.pos_camera_ned_m[2]
        if height_m <= 0.0:
            return False
        if self._m_per_px == 0.0:
            self._m_per_px = COARSER * height_m / image.focal_px
        to_image = _image_from_ground(image, rotation, ground_m)
        self._make_room(image, to_image)
        self._paint(image, _without_distortion(image, pixels), to_image)
        self.count += 1
        return True

    def encoded(self) -> tuple[bytes, MapPlace] | None:
        """The map as WebP, transparent where no image shows the ground, and its place; None without an image."""
        if self.count == 0:
            return None
        rows, columns = self._away_m2.shape
        _, data = cv2.imencode(".webp", self._colours, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
        scale = self._m_per_px
        return data.tobytes(), MapPlace(-scale * self._row0, scale * self._column0, scale * rows, scale * columns)

    def _ground_m(self, image: Image, tilt_cos: float) -> float:
        """Down coordinate of the ground; that of the world's origin until the altimeter has measured it."""
        if image.range_m is not None:
            self._grounds_m = [*self._grounds_m, image.pos_camera_ned_m[2] + image.range_m * tilt_cos][-GROUND_KEPT:]
        return median(self._grounds_m) if self._grounds_m else 0.0

    def _make_room(self, image: Image, to_image: NDArray[np.float64]) -> None:
        """Enlarge the map so that it contains an image; a map that becomes too large gets coarser."""
        north_m, east_m = _corners_on_ground(image, to_image)
        while True:
            rows, columns = -north_m / self._m_per_px, east_m / self._m_per_px
            top, bottom = _stretched(self._row0, self._away_m2.shape[0], rows)
            left, right = _stretched(self._column0, self._away_m2.shape[1], columns)
            if (bottom - top) * (right - left) <= PIXELS_MAX:
                break
            self._halve()
        up, to_left = self._row0 - top, self._column0 - left
        old_rows, old_columns = self._away_m2.shape
        if (bottom - top, right - left) != (old_rows, old_columns):
            colours = np.zeros((bottom - top, right - left, 4), np.uint8)
            away_m2 = np.full((bottom - top, right - left), np.inf, np.float32)
            if old_rows:
                colours[up : up + old_rows, to_left : to_left + old_columns] = self._colours
                away_m2[up : up + old_rows, to_left : to_left + old_columns] = self._away_m2
            self._colours, self._away_m2 = colours, away_m2
        self._row0, self._column0 = top, left

    def _halve(self) -> None:
        """Make the map coarser by a factor of two. Its first row and column stay multiples of the step."""
        self._m_per_px *= 2.0
        rows, columns = self._away_m2.shape
        pad = ((self._row0 % (2 * STEP_PX), rows), (self._column0 % (2 * STEP_PX), columns))
        grown = [(before, -(before + size) % (2 * STEP_PX)) for before, size in pad]
        colours = np.pad(self._colours, (*grown, (0, 0)))
        away_m2 = np.pad(self._away_m2, grown, constant_values=np.inf)
        self._row0, self._column0 = (self._row0 - grown[0][0]) // 2, (self._column0 - grown[1][0]) // 2
        if rows:
            self._colours, self._away_m2 = colours[::2, ::2].copy(), away_m2[::2, ::2].copy()

    def _paint(self, image: Image, pixels: Pixels, to_image: NDArray[np.float64]) -> None:
        """Show an image in all pixels of the map to which its camera is the nearest so far."""
        corners_north_m, corners_east_m = _corners_on_ground(image, to_image)
        rows = -corners_north_m / self._m_per_px - self._row0
        columns = corners_east_m / self._m_per_px - self._column0
        top, left = max(floor(rows.min()), 0), max(floor(columns.min()), 0)
        bottom, right = ceil(rows.max()) + 1, ceil(columns.max()) + 1
        part = (slice(top, bottom), slice(left, right))
        away_m2, colours = self._away_m2[part], self._colours[part]
        scale = self._m_per_px
        ground_from_part = np.array(
            (
                (0.0, -scale, -scale * (self._row0 + top + 0.5)),
                (scale, 0.0, scale * (self._column0 + left + 0.5)),
                (0.0, 0.0, 1.0),
            )
        )
        warped = cv2.warpPerspective(
            pixels,
            to_image @ ground_from_part,
            away_m2.shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
        )
        north_m = -scale * (self._row0 + top + 0.5 + np.arange(away_m2.shape[0], dtype=np.float32))
        east_m = scale * (self._column0 + left + 0.5 + np.arange(away_m2.shape[1], dtype=np.float32))
        camera_north_m, camera_east_m, _ = image.pos_camera_ned_m
        own_m2 = ((north_m - camera_north_m) ** 2)[:, None] + ((east_m - camera_east_m) ** 2)[None, :]
        better = (warped[:, :, 3] == 255) & (own_m2 < away_m2)
        colours[better] = warped[better]
        away_m2[better] = own_m2[better]


def _stretched(first: int, size: int, places: NDArray[np.float64]) -> tuple[int, int]:
    """First and last row of a map that also contains some places, in steps."""
    low, high = floor(places.min() / STEP_PX) * STEP_PX, (floor(places.max() / STEP_PX) + 1) * STEP_PX
    return (min(first, low), max(first + size, high)) if size else (low, high)


def _corners_on_ground(image: Image, to_image: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """North and east of an image's four corners."""
    width_px, height_px = image.width_px, image.height_px
    corners = np.array([(0, 0, 1), (width_px, 0, 1), (width_px, height_px, 1), (0, height_px, 1)], float).T
    ground = np.linalg.solve(to_image, corners)
    return ground[0] / ground[2], ground[1] / ground[2]


def _image_from_ground(image: Image, rotation: NDArray[np.float64], ground_m: float) -> NDArray[np.float64]:
    """(3, 3) homography from north, east and 1 on level ground to pixels of an image without distortion."""
    north_m, east_m, down_m = image.pos_camera_ned_m
    from_camera = np.array(((1.0, 0.0, -north_m), (0.0, 1.0, -east_m), (0.0, 0.0, ground_m - down_m)))
    return np.asarray(_pinhole(image) @ rotation.T @ from_camera)


def _pinhole(image: Image) -> NDArray[np.float64]:
    """(3, 3) camera matrix."""
    (cx, cy), f = image.center_px, image.focal_px
    return np.array(((f, 0.0, cx), (0.0, f, cy), (0.0, 0.0, 1.0)))


def _without_distortion(image: Image, pixels: bytes) -> Pixels:
    """(height, width, 4) blue, green, red and opacity of an image."""
    picture = np.frombuffer(pixels, np.uint8).reshape(image.height_px, image.width_px, 3)
    opaque = cv2.cvtColor(picture, cv2.COLOR_RGB2BGRA)
    opaque = undistorted_picture(
        np.asarray(opaque, np.uint8), image.focal_px, image.center_px, image.distortion, image.aspect
    )
    return np.asarray(opaque, np.uint8)
