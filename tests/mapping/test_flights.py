"""Maps of coverages that took several flights: their positions differ, their images are in one map."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from jezero.base.frames import geodetic_from_ned
from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.main import main
from jezero.mapping.making import Map, make_map
from tests.mapping.painted_ground import M_PER_PX, change_images, dataset, displacement_m

ORIGIN_DEG = (47.397742, 8.545594, 488.0)
S_NS = 1_000_000_000


def made(folder: Path) -> Map:
    return make_map(folder, M_PER_PX, VehicleConfig())


def distortion_m(result: Map, ground: NDArray[np.uint8]) -> float:
    """Median error of the map without a common shift."""
    errors_m = displacement_m(result.mosaic, ground, reach_m=2.0)
    return float(np.median(np.linalg.norm(errors_m - np.median(errors_m, axis=0), axis=1)))


def take_at(folder: Path, times_s: dict[int, float]) -> None:
    """Change the times of some images."""

    def change(image: dict[str, Any]) -> None:
        if image["index"] in times_s:
            image["t_ns"] = round(times_s[image["index"]] * S_NS)

    change_images(folder, change)


def shift(folder: Path, numbers: set[int], north_m: float, east_m: float) -> None:
    """Give some images another position, as a second flight would."""

    def change(image: dict[str, Any]) -> None:
        if image["index"] in numbers:
            north, east, down = image["pos_camera_ned_m"]
            image["pos_camera_ned_m"] = (north + north_m, east + east_m, down)

    change_images(folder, change)


@pytest.mark.parametrize(
    "times_s",
    [
        {2: 100.0},
        {2: 8.0},  # 2 s after the next one: the standard deviation of the way between them would be 0
        {0: 100.0, 1: 102.0},
        {5: 8.0},
        dict.fromkeys(range(6), 0.0),
        {3: 1.0, 4: 2.0, 5: 3.0},
    ],
    ids=["one later", "one 2 s later", "the first ones later", "two at once", "all at once", "time began anew"],
)
def test_images_may_have_been_taken_in_any_order_and_at_any_time(tmp_path: Path, times_s: dict[int, float]) -> None:
    ground = dataset(tmp_path, wander_m=0.02)
    take_at(tmp_path, times_s)
    result = made(tmp_path)
    assert result.alignment.after_m < 0.01 and distortion_m(result, ground) < 0.05


@pytest.mark.long
@pytest.mark.parametrize("times_s", [{}, {3: 107.0, 4: 109.0, 5: 111.0}], ids=["times follow", "times apart"])
@pytest.mark.parametrize("apart_m", [(1.2, 0.0), (-0.9, 0.8), (2.5, -1.0)])
def test_two_flights_whose_positions_differ_are_one_map_without_a_step(
    tmp_path: Path, apart_m: tuple[float, float], times_s: dict[int, float]
) -> None:
    ground = dataset(tmp_path)
    shift(tmp_path, {3, 4, 5}, *apart_m)
    take_at(tmp_path, times_s)
    result = made(tmp_path)
    assert result.alignment.groups == (6,)
    assert result.alignment.after_m < 0.01 and distortion_m(result, ground) < 0.05


def test_images_without_ground_in_common_are_told_as_groups(tmp_path: Path) -> None:
    dataset(tmp_path)
    shift(tmp_path, {4, 5}, 30.0, 0.0)
    runner = CliRunner().invoke(main, ["map", str(tmp_path), "--resolution", "0.05"])
    assert runner.exit_code == 0
    assert "warning: 2 groups of images (4, 2) have no ground in common" in runner.output
    runner = CliRunner().invoke(main, ["map", str(tmp_path), "--resolution", "0.05", "--json"])
    assert json.loads(runner.output)["groups"] == [4, 2]


def test_flights_with_different_origins_are_put_in_one_frame_by_their_degrees(tmp_path: Path) -> None:
    ground = dataset(tmp_path)
    second_deg = geodetic_from_ned((12.0, -7.0, 3.0), ORIGIN_DEG)

    def change(image: dict[str, Any]) -> None:
        pos_m = image["pos_camera_ned_m"]
        image["position_camera_deg"] = geodetic_from_ned(pos_m, ORIGIN_DEG)
        if image["index"] >= 3:
            image["pos_camera_ned_m"] = (pos_m[0] - 12.0, pos_m[1] + 7.0, pos_m[2])
            image["position_camera_deg"] = geodetic_from_ned(image["pos_camera_ned_m"], second_deg)

    change_images(tmp_path, change)
    result = made(tmp_path)
    assert result.alignment.groups == (6,)
    assert distortion_m(result, ground) < 0.02 and result.alignment.before_m < 0.03
    assert result.origin_deg == pytest.approx(ORIGIN_DEG, abs=1e-8)
