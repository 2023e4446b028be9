"""A painted plane and pictures of it from known poses."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from jezero.base.frames import Quat, Vec3, quat_from_euler, quat_multiply, quat_normalize
from jezero.base.lens import undistort
from jezero.mapping.mosaic import Mosaic
from jezero.schemas.images import LISTING
from jezero.schemas.sensors import NO_DISTORTION, Distortion

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 180, 136, 112.0
HEIGHT_M = 4.0
M_PER_PX = 0.02
MIDDLES_M = [(north, east) for north in (-0.5, 1.5) for east in (-1.5, 0.5, 2.5)]
LOOKING_DOWN = (0.5, 0.5, 0.5, 0.5)


def painted(side_px: int = 700) -> NDArray[np.uint8]:
    """Ground of 14 m to a side, north at the top and (0, 0) in its middle."""
    rng = np.random.default_rng(5)
    layers = [cv2.resize(rng.uniform(0, 255, (n, n, 3)), (side_px, side_px)) for n in (40, 120, 350)]
    return np.clip(sum(layers) / 3.0, 0, 255).astype(np.uint8)


def through_lens(picture: NDArray[np.uint8], distortion: Distortion) -> NDArray[np.uint8]:
    """The picture of a lens with distortion, from that of an ideal lens."""
    columns, rows = np.meshgrid(np.arange(WIDTH_PX, dtype=float), np.arange(HEIGHT_PX, dtype=float))
    center_px = np.array((0.5 * (WIDTH_PX - 1), 0.5 * (HEIGHT_PX - 1)))
    seen = undistort((np.stack((columns, rows), axis=-1) - center_px) / FOCAL_PX, distortion)
    at_px = (FOCAL_PX * seen + center_px).astype(np.float32)
    return np.asarray(cv2.remap(picture, at_px[..., 0], at_px[..., 1], cv2.INTER_LINEAR), np.uint8)


Paint = Callable[[NDArray[np.uint8], int, NDArray[np.float64]], NDArray[np.uint8]]
"""Paints on a picture, given its number and the (3, 3) matrix from pixels of the painted ground to its own."""


def as_it_is(picture: NDArray[np.uint8], index: int, picture_from_px: NDArray[np.float64]) -> NDArray[np.uint8]:
    return picture


def dataset(
    folder: Path,
    *,
    wander_m: float = 0.0,
    yaw_error_rad: float = 0.0,
    distortion: Distortion = NO_DISTORTION,
    paint: Paint = as_it_is,
) -> NDArray[np.uint8]:
    """Six pictures that overlap; they are told to be 0.1 m aside, and more by as much from one to the next.

    Args:
        paint: paints what else is on each picture.

    Returns:
        The painted ground.
    """
    ground, rng = painted(), np.random.default_rng(1)
    error_m = np.full(2, 0.1 if wander_m else 0.0)
    images: list[dict[str, Any]] = []
    (folder / "images").mkdir()
    for index, (north_m, east_m) in enumerate(MIDDLES_M):
        yaw_rad = rng.uniform(-0.1, 0.1)
        picture_from_px = picture_matrix(north_m, east_m, yaw_rad)
        picture = np.asarray(cv2.warpPerspective(ground, picture_from_px, (WIDTH_PX, HEIGHT_PX)), np.uint8)
        picture = paint(picture, index, picture_from_px)
        picture = through_lens(picture, distortion)
        cv2.imwrite(str(folder / "images" / f"{index:04d}.png"), picture[:, :, ::-1])
        error_m += rng.uniform(-wander_m, wander_m, 2)
        told_m = (north_m + error_m[0], east_m + error_m[1], -HEIGHT_M)
        q_ned_from_frd = quat_from_euler(0.0, 0.0, yaw_rad + yaw_error_rad)
        images.append({**_entry(index, told_m, q_ned_from_frd, distortion), "yaw_rad": yaw_rad})
    (folder / LISTING).write_text(json.dumps({"images": images}))
    return ground


def _entry(index: int, told_m: Vec3, q_ned_from_frd: Quat, distortion: Distortion) -> dict[str, Any]:
    """Entry of a picture in the listing, for a camera at `told_m` that looks down."""
    q_frd_from_camera = quat_multiply(quat_from_euler(0.0, -0.5 * np.pi, 0.0), LOOKING_DOWN)
    return {
        "file": f"{index:04d}.png",
        "index": index,
        "t_ns": 2_000_000_000 * index,
        "pos_uav_ned_m": told_m,
        "q_ned_from_frd": q_ned_from_frd,
        "pos_camera_ned_m": told_m,
        "q_ned_from_camera": quat_normalize(quat_multiply(q_ned_from_frd, q_frd_from_camera)),
        "pitch_camera_rad": -1.5708,
        "exposure_s": 0.004,
        "width_px": WIDTH_PX,
        "height_px": HEIGHT_PX,
        "focal_px": FOCAL_PX,
        "center_px": (0.5 * (WIDTH_PX - 1), 0.5 * (HEIGHT_PX - 1)),
        "distortion": distortion,
        "range_m": HEIGHT_M - 0.02,
    }


def picture_matrix(north_m: float, east_m: float, yaw_rad: float) -> NDArray[np.float64]:
    """(3, 3) from pixels of the painted ground to those of a picture taken straight above a place."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    right, down = np.array((-s, c)), np.array((-c, -s))
    scale = FOCAL_PX / HEIGHT_M
    # north = 7 - M_PER_PX * row, east = M_PER_PX * column - 7, of the pixels' middles
    place_from_px = np.array(((0.0, -M_PER_PX, 7.0 - north_m), (M_PER_PX, 0.0, -7.0 - east_m), (0.0, 0.0, 1.0)))
    picture_from_place = np.array(
        (
            (scale * right[0], scale * right[1], 0.5 * (WIDTH_PX - 1)),
            (scale * down[0], scale * down[1], 0.5 * (HEIGHT_PX - 1)),
            (0.0, 0.0, 1.0),
        )
    )
    return np.asarray(picture_from_place @ place_from_px)


def change_images(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change each image of a dataset's list."""
    listing = json.loads((folder / LISTING).read_text())
    for image in listing["images"]:
        change(image)
    (folder / LISTING).write_text(json.dumps(listing))


def displacement_m(mosaic: Mosaic, ground: NDArray[np.uint8], reach_m: float = 0.6) -> NDArray[np.float64]:
    """(k, 2) how far, north and east, patches of the map are from where they belong, up to `reach_m`."""
    reach_px = round(reach_m / M_PER_PX)
    found = []
    for north_m in (-0.5, 0.5, 1.5):
        for east_m in (-1.5, 0.0, 1.5, 2.5):
            row, column = round((mosaic.north_m - north_m) / M_PER_PX), round((east_m - mosaic.east_m) / M_PER_PX)
            patch = mosaic.pixels[row - 20 : row + 20, column - 20 : column + 20]
            top, left = round((7.0 - north_m) / M_PER_PX) - 20, round((east_m + 7.0) / M_PER_PX) - 20
            window = ground[top - reach_px : top + 40 + reach_px, left - reach_px : left + 40 + reach_px]
            _, _, _, (right, down) = cv2.minMaxLoc(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED))
            found.append((M_PER_PX * (down - reach_px), -M_PER_PX * (right - reach_px)))
    return np.array(found)
