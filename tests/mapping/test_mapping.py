"""Maps from pictures of a painted plane: taken from poses that are told wrongly, they end up where things are."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.main import main
from jezero.mapping.ground import fit_ground
from jezero.mapping.making import make_map
from jezero.mapping.survey import SurveyError, read_survey
from jezero.schemas.images import LISTING
from jezero.schemas.sensors import Distortion
from tests.mapping.painted_ground import FOCAL_PX, HEIGHT_M, HEIGHT_PX, M_PER_PX, WIDTH_PX, dataset, displacement_m


def test_pictures_from_known_poses_make_a_map_that_is_where_things_are(tmp_path: Path) -> None:
    ground = dataset(tmp_path)
    assert np.abs(displacement_m(make_map(tmp_path, M_PER_PX, VehicleConfig()).mosaic, ground)).max() <= 1.5 * M_PER_PX


@pytest.mark.long
@pytest.mark.parametrize("distortion", [(-0.25, 0.05, 0.0, 0.0, 0.0), (0.25, 0.0, 0.001, -0.001, 0.0)])
def test_pictures_of_a_lens_with_distortion_make_the_same_map_and_nothing_that_the_lens_does_not_show(
    tmp_path: Path, distortion: Distortion
) -> None:
    ground = dataset(tmp_path, distortion=distortion)
    mosaic = make_map(tmp_path, M_PER_PX, VehicleConfig()).mosaic
    assert np.abs(displacement_m(mosaic, ground)).max() <= 1.5 * M_PER_PX
    top, left = round((7.0 - mosaic.north_m) / M_PER_PX), round((mosaic.east_m + 7.0) / M_PER_PX)
    rows, columns = mosaic.seen.shape
    expected = ground[top : top + rows, left : left + columns].astype(float)
    error = np.abs(mosaic.pixels.astype(float) - expected).mean(axis=2)[mosaic.seen]
    assert np.median(error) < 25.0 and np.mean(mosaic.pixels[mosaic.seen].max(axis=1) < 10) < 1e-4


def test_what_pictures_show_in_common_puts_them_right_but_for_a_common_shift(tmp_path: Path) -> None:
    ground = dataset(tmp_path, wander_m=0.04, yaw_error_rad=0.02)
    made = make_map(tmp_path, M_PER_PX, VehicleConfig())
    astray_m = displacement_m(made.mosaic, ground)
    rest_m = np.linalg.norm(astray_m - np.median(astray_m, axis=0), axis=1)
    assert made.alignment.before_m > 0.03 and made.alignment.after_m < 0.01
    assert np.median(rest_m) < 0.05
    assert np.median(astray_m, axis=0) == pytest.approx((0.1, 0.1), abs=0.1)


def test_the_world_file_says_where_the_first_pixel_is(tmp_path: Path) -> None:
    dataset(tmp_path)
    result = CliRunner().invoke(main, ["map", str(tmp_path), "--resolution", "0.05", "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.output)
    assert told["pictures"] == 6 and told["pairs"] > 5
    numbers = [float(line) for line in (tmp_path / "map.pgw").read_text().split()]
    assert numbers[:4] == [0.05, 0.0, 0.0, -0.05]
    half_m = 0.5 * HEIGHT_M / FOCAL_PX * HEIGHT_PX
    assert numbers[5] == pytest.approx(1.5 + half_m, abs=0.4)
    assert numbers[4] == pytest.approx(-1.5 - 0.5 * HEIGHT_M / FOCAL_PX * WIDTH_PX, abs=0.4)
    picture = cv2.imread(str(tmp_path / "map.png"), cv2.IMREAD_UNCHANGED)
    assert (
        picture is not None
        and picture.shape[2] == 4
        and 0.05 * picture.shape[0] == pytest.approx(2.0 + 2.0 * half_m, abs=0.8)
    )
    assert set(np.unique(picture[:, :, 3])) == {0, 255}


def test_the_ground_follows_the_altimeter_and_leaves_out_what_stands_on_it() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(-5.0, 5.0, (60, 2))
    down = 0.3 - 0.05 * places[:, 0] + 0.02 * places[:, 1] + 0.02 * rng.standard_normal(60)
    spots = np.column_stack((places, down))
    spots[:3, 2] -= 0.8
    ground = fit_ground(spots)
    assert ground.down_m(np.array(((0.0, 0.0), (4.0, 0.0), (0.0, -4.0)))) == pytest.approx((0.3, 0.1, 0.22), abs=0.05)
    met = ground.met(np.array((0.0, 0.0, -5.0)), np.array(((0.0, 0.0, 1.0), (0.3, 0.0, 1.0), (0.0, 0.0, -1.0))))
    assert met[0, 2] == pytest.approx(0.3, abs=0.05)
    assert met[1, 0] == pytest.approx(0.3 * (met[1, 2] + 5.0), abs=1e-3)
    assert np.isnan(met[2]).all()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "has no images/images.json"),
        ("{", "is not a dataset's list"),
        ('{"images": []}', "lists no images"),
        ('{"images": [{"file": "a.jpg"}]}', "is not a dataset's list"),
    ],
)
def test_a_folder_without_pictures_says_what_is_wrong(tmp_path: Path, text: str | None, why: str) -> None:
    if text is not None:
        (tmp_path / "images").mkdir()
        (tmp_path / LISTING).write_text(text)
    with pytest.raises(SurveyError, match=why):
        read_survey(tmp_path, VehicleConfig())


def test_pictures_without_a_range_or_a_file_can_not_be_mapped(tmp_path: Path) -> None:
    dataset(tmp_path)
    (tmp_path / "images" / "0003.png").unlink()
    result = CliRunner().invoke(main, ["map", str(tmp_path)])
    assert result.exit_code == 1 and "0003.png can't be read" in result.output
    listing = json.loads((tmp_path / LISTING).read_text())
    for image in listing["images"]:
        del image["range_m"]
    (tmp_path / LISTING).write_text(json.dumps(listing))
    with pytest.raises(SurveyError, match="the laser reaches 10 m, fly lower"):
        read_survey(tmp_path, VehicleConfig())


def test_two_spots_far_apart_in_height_are_a_ground_all_the_same() -> None:
    ground = fit_ground(np.array(((0.0, 0.0, 0.0), (1.0, 0.0, -3.0))))
    assert np.isfinite(ground.down_m(np.array(((0.5, 0.0),)))).all()
