"""The map that grows during a coverage, from images of a painted ground."""

from math import radians

import cv2
import numpy as np
import pytest

from jezero.base.frames import quat_from_euler, quat_multiply
from jezero.schemas.images import Image
from jezero.services.ground_station import growing_map
from jezero.services.ground_station.growing_map import GrowingMap, MapPlace

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 320, 240, 200.0
DOWN = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
"""Attitude of a camera that looks straight down, with its upper edge to the north: right is east, down is south."""
RED, GREEN = (200, 40, 40), (40, 200, 40)


def image_at(north_m: float, east_m: float, height_m: float = 4.0, index: int = 0, tilt_deg: float = 0.0) -> Image:
    """Description of an image from a camera over a ground one metre below the world's origin."""
    tilt = quat_from_euler(radians(tilt_deg), 0.0, 0.0)
    return Image(
        index=index,
        t_ns=index,
        pos_uav_ned_m=(north_m, east_m, 1.0 - height_m),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        yaw_rad=0.0,
        pos_camera_ned_m=(north_m, east_m, 1.0 - height_m),
        q_ned_from_camera=quat_multiply(tilt, DOWN),
        pitch_camera_rad=-1.57,
        exposure_s=0.001,
        width_px=WIDTH_PX,
        height_px=HEIGHT_PX,
        focal_px=FOCAL_PX,
        center_px=(WIDTH_PX / 2 - 0.5, HEIGHT_PX / 2 - 0.5),
        range_m=height_m,
    )


def halves() -> bytes:
    """Pixels that are red in the upper half, which is north, and green in the lower one."""
    pixels = np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    pixels[: HEIGHT_PX // 2], pixels[HEIGHT_PX // 2 :] = RED, GREEN
    return pixels.tobytes()


def plain(colour: tuple[int, int, int]) -> bytes:
    return (np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8) + np.array(colour, np.uint8)).tobytes()


def picture_of(made: GrowingMap) -> tuple[growing_map.Pixels, MapPlace]:
    shown = made.encoded()
    assert shown is not None
    picture = cv2.imdecode(np.frombuffer(shown[0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return np.asarray(picture, np.uint8), shown[1]


def colour_at(made: GrowingMap, north_m: float, east_m: float) -> tuple[int, ...]:
    """Red, green, blue and opacity at a place; all zero outside."""
    picture, place = picture_of(made)
    row = int((place.north_m - north_m) / place.height_m * picture.shape[0])
    column = int((east_m - place.east_m) / place.width_m * picture.shape[1])
    if not (0 <= row < picture.shape[0] and 0 <= column < picture.shape[1]):
        return (0, 0, 0, 0)
    blue, green, red, alpha = picture[row, column]
    return int(red), int(green), int(blue), int(alpha)


def is_like(colour: tuple[int, ...], expected: tuple[int, int, int]) -> bool:
    return colour[3] == 255 and max(abs(a - b) for a, b in zip(colour, expected, strict=False)) < 30


def test_an_image_lies_where_its_camera_looked_with_north_at_the_top() -> None:
    made = GrowingMap()
    assert made.encoded() is None
    assert made.add(image_at(10.0, -20.0), halves())
    # 4 m over the ground, 240 pixels of a focal length of 200 are 2.4 m to the north and south, 3.2 m east and west
    assert is_like(colour_at(made, 11.5, -20.0), RED)
    assert is_like(colour_at(made, 8.5, -20.0), GREEN)
    assert is_like(colour_at(made, 11.5, -17.2), RED)
    assert colour_at(made, 13.2, -20.0)[3] == 0
    assert colour_at(made, 10.0, -16.2)[3] == 0


def test_each_place_shows_the_camera_that_was_nearest_whatever_came_first() -> None:
    for order in ((0, 1), (1, 0)):
        made = GrowingMap()
        for index in order:
            made.add(image_at(0.0, 3.0 * index, index=index), plain((RED, GREEN)[index]))
        assert made.count == 2
        assert is_like(colour_at(made, 0.0, 1.2), RED)
        assert is_like(colour_at(made, 0.0, 1.8), GREEN)


def test_a_picture_to_the_side_is_left_out() -> None:
    made = GrowingMap()
    assert not made.add(image_at(0.0, 0.0, tilt_deg=60.0), plain(RED))
    assert made.encoded() is None


def test_a_large_map_gets_coarser_and_keeps_what_it_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_map, "PIXELS_MAX", 200_000)
    made = GrowingMap()
    for index in range(12):
        made.add(image_at(-4.0 * index, 7.0 * index, index=index), plain(RED if index % 2 else GREEN))
    picture, place = picture_of(made)
    assert picture.shape[0] * picture.shape[1] <= 200_000
    assert place.width_m >= 77.0
    for index in range(12):
        assert is_like(colour_at(made, -4.0 * index, 7.0 * index), RED if index % 2 else GREEN), index
