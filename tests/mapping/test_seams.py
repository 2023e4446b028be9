"""The map shows each place as one picture does: nothing blurred, cut or moved."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from jezero.base.vehicle_config import VehicleConfig
from jezero.mapping.making import make_map
from jezero.mapping.mosaic import Mosaic
from jezero.schemas.images import LISTING
from tests.mapping.painted_ground import HEIGHT_M, M_PER_PX, dataset

BOARD_M, BOARD_HEIGHT_M = 1.0, 0.5
BOARD_NORTH_M, BOARD_EAST_M = 0.6, 0.4
SQUARES = 6
VISIBLE_LIKENESS = 0.9


def board() -> NDArray[np.uint8]:
    """Black and white squares with a white border, as wide as it is on the ground below it."""
    squares = np.random.default_rng(3).integers(0, 2, (SQUARES, SQUARES)).astype(np.uint8) * 255
    side_px = round(BOARD_M / M_PER_PX)
    inner = cv2.resize(squares, (side_px - 12, side_px - 12), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.cvtColor(np.pad(inner, 6, constant_values=255), cv2.COLOR_GRAY2RGB), np.uint8)


def with_board(picture: NDArray[np.uint8], index: int, picture_from_px: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The picture with a board that stands above the ground, so that it leans away from the picture's middle."""
    side_px = round(BOARD_M / M_PER_PX)
    top = round((7.0 - BOARD_NORTH_M) / M_PER_PX - 0.5 * side_px)
    left = round((7.0 + BOARD_EAST_M) / M_PER_PX - 0.5 * side_px)
    ground_from_board = np.array(((1.0, 0.0, left), (0.0, 1.0, top), (0.0, 0.0, 1.0)))
    middle = 0.5 * (np.array(picture.shape[1::-1]) - 1.0)
    nearer = HEIGHT_M / (HEIGHT_M - BOARD_HEIGHT_M)
    lean = np.array(((nearer, 0.0, middle[0] * (1 - nearer)), (0.0, nearer, middle[1] * (1 - nearer)), (0, 0, 1.0)))
    size = picture.shape[1::-1]
    matrix = lean @ picture_from_px @ ground_from_board
    shown = np.asarray(cv2.warpPerspective(board(), matrix, size), np.uint8)
    mask = cv2.warpPerspective(np.ones(board().shape[:2], np.uint8), matrix, size) > 0
    return np.where(mask[:, :, None], shown, picture)


def with_driving_board(
    picture: NDArray[np.uint8], index: int, picture_from_px: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """The picture with a board that is 1.2 m farther to the east in each picture."""
    farther = np.eye(3)
    farther[0, 2] = 1.2 * (index - 2.0) / M_PER_PX
    return with_board(picture, index, picture_from_px @ farther)


def with_shadow(picture: NDArray[np.uint8], index: int, picture_from_px: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The picture with the vehicle's shadow near its middle."""
    result = picture.copy()
    rows, columns = result.shape[:2]
    place = (slice(rows // 2 + 5, rows // 2 + 20), slice(columns // 2 - 25, columns // 2 - 8))
    result[place] = result[place] // 3
    return result


def made(folder: Path) -> Mosaic:
    return make_map(folder, M_PER_PX, VehicleConfig()).mosaic


def ground_below(mosaic: Mosaic, ground: NDArray[np.uint8]) -> NDArray[np.float64]:
    """The part of the painted ground that the map shows."""
    top, left = round((7.0 - mosaic.north_m) / M_PER_PX), round((mosaic.east_m + 7.0) / M_PER_PX)
    rows, columns = mosaic.seen.shape
    return ground[top : top + rows, left : left + columns].astype(float)


def gradient_energy(pixels: NDArray[np.uint8]) -> float:
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(float)
    return float(np.mean(np.diff(grey, axis=0) ** 2) + np.mean(np.diff(grey, axis=1) ** 2))


def test_what_stands_on_the_ground_comes_whole_from_one_picture(tmp_path: Path) -> None:
    dataset(tmp_path, paint=with_board)
    mosaic = made(tmp_path)
    nearer = HEIGHT_M / (HEIGHT_M - BOARD_HEIGHT_M)
    seen_from_above = cv2.resize(board(), None, fx=nearer, fy=nearer, interpolation=cv2.INTER_LINEAR)
    likeness = cv2.matchTemplate(mosaic.pixels, np.asarray(seen_from_above, np.uint8), cv2.TM_CCOEFF_NORMED)
    assert likeness.max() > VISIBLE_LIKENESS


@pytest.mark.long
def test_ground_around_what_stands_on_it_keeps_the_detail_of_a_single_picture(tmp_path: Path) -> None:
    (tmp_path / "with").mkdir()
    (tmp_path / "without").mkdir()
    dataset(tmp_path / "with", paint=with_board)
    dataset(tmp_path / "without")
    mosaic, plain = made(tmp_path / "with"), made(tmp_path / "without")
    around = 0.9
    row, column = round((mosaic.north_m - BOARD_NORTH_M) / M_PER_PX), round((BOARD_EAST_M - mosaic.east_m) / M_PER_PX)
    reach = round(around / M_PER_PX)
    for north, east in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        place = (
            slice(row + reach * north - 12, row + reach * north + 12),
            slice(column + reach * east - 12, column + reach * east + 12),
        )
        assert gradient_energy(mosaic.pixels[place]) > 0.9 * gradient_energy(plain.pixels[place])


def test_a_shadow_that_moves_with_the_vehicle_is_not_in_the_map(tmp_path: Path) -> None:
    ground = dataset(tmp_path, paint=with_shadow)
    mosaic = made(tmp_path)
    shadow_levels = 60.0
    darker = cv2.blur(ground_below(mosaic, ground).mean(axis=2) - mosaic.pixels.mean(axis=2), (9, 9))
    # At the map's edge only one picture shows the ground.
    inside = cv2.erode(mosaic.seen.astype(np.uint8), np.ones((75, 75), np.uint8)) > 0
    assert darker[inside].max() < 0.5 * shadow_levels


def with_other_exposures(
    picture: NDArray[np.uint8], index: int, picture_from_px: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """The picture of a camera that sets its exposure and white balance anew for each."""
    gains = np.random.default_rng(index).uniform(0.6, 1.0, 3)
    return np.asarray(np.rint(gains * picture), np.uint8)


def test_a_rover_that_drives_is_not_in_the_map_where_most_pictures_show_the_ground(tmp_path: Path) -> None:
    ground = dataset(tmp_path, paint=with_driving_board)
    mosaic = made(tmp_path)
    error = np.abs(mosaic.pixels - ground_below(mosaic, ground)).mean(axis=2)
    blurred = cv2.blur(error, (9, 9))
    row, column = round(mosaic.north_m / M_PER_PX), round(-mosaic.east_m / M_PER_PX)
    middle = (slice(row - 60, row + 20), slice(column - 40, column + 110))  # shown by four pictures and more
    assert np.mean(blurred[middle] > 60.0) < 0.01


def test_pictures_with_different_exposures_are_one_map_without_steps(tmp_path: Path) -> None:
    ground = dataset(tmp_path, paint=with_other_exposures)
    mosaic = made(tmp_path)
    inside = cv2.erode(mosaic.seen.astype(np.uint8), np.ones((51, 51), np.uint8)) > 0
    shown = np.asarray(cv2.blur(mosaic.pixels.astype(float), (25, 25)))
    below = np.asarray(cv2.blur(ground_below(mosaic, ground), (25, 25)))
    ratios = (shown / below)[inside]
    assert np.ptp(np.percentile(ratios, (1, 99), axis=0), axis=0).max() < 0.05


def test_a_picture_alone_is_a_map(tmp_path: Path) -> None:
    dataset(tmp_path)
    listing = tmp_path / LISTING
    listing.write_text(json.dumps({"images": json.loads(listing.read_text())["images"][:1]}))
    assert made(tmp_path).seen.mean() > 0.8


@pytest.mark.long
@pytest.mark.parametrize("m_per_px", [0.01, 0.05, 0.2, 1.0])
def test_a_map_can_be_finer_and_coarser_than_its_pictures(tmp_path: Path, m_per_px: float) -> None:
    dataset(tmp_path)
    mosaic = make_map(tmp_path, m_per_px, VehicleConfig()).mosaic
    width_m, height_m = m_per_px * mosaic.seen.any(axis=0).sum(), m_per_px * mosaic.seen.any(axis=1).sum()
    assert width_m == pytest.approx(10.4, abs=0.5 + 2 * m_per_px)
    assert height_m == pytest.approx(6.9, abs=0.5 + 2 * m_per_px)
