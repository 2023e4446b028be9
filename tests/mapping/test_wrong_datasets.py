"""Datasets that other programs, or people, have changed: each becomes a map or is refused with a reason."""

import json
import random
from pathlib import Path
from typing import Any

import pytest

from jezero.base.vehicle_config import VehicleConfig
from jezero.mapping.making import make_map
from jezero.mapping.survey import SurveyError, read_survey
from jezero.schemas.images import LISTING
from tests.mapping.painted_ground import dataset

FIELDS_PER_DATASET = 2
OF_ANY_TYPE: list[Any] = [0, -1, 1e9, -1e9, 1e300, None, "x", [], {}, True, [0, 0, 0], [1, 0, 0, 0], 1e-9, 5000]
PLAUSIBLE: dict[str, list[Any]] = {
    "pos_camera_ned_m": [[0.5, 0, -4], [0, 0, -0.1], [0, 0, 0], [0, 0, 4], [1000, 0, -4], [0, 1e5, -4], [0, 0, -1e4]],
    "q_ned_from_camera": [[1, 0, 0, 0], [0, 0, 0, 0], [0.5, 0.5, 0.5, 0.5], [0.7, 0.7, 0, 0], [1, 1, 1, 1]],
    "q_ned_from_frd": [[0, 0, 0, 0], [0, 1, 0, 0], [0.1, 0.2, 0.3, 0.4]],
    "t_ns": [0, 1, 10**9, 4 * 10**9, 10**18],
    "range_m": [0, 0.01, 3.9, 10, 1000, 1e6, None],
    "focal_px": [0, 1.12, 11.2, 224, 1120, 1.12e5],
    "distortion": [[-0.5, 0, 0, 0, 0], [5, 0, 0, 0, 0], [0, 100, 0, 0, 0], [0, 0, 0.5, -0.5, -5]],
    "position_camera_deg": [[0, 0, 0], [90, 0, 0], [-90, 180, 0], [45, -180, 0], None],
}
OF_ALL_IMAGES = ("focal_px", "distortion")


def changed(listing: dict[str, Any], rng: random.Random) -> None:
    """Change some fields of one image or of all."""
    images = listing["images"]
    for _ in range(rng.randint(1, FIELDS_PER_DATASET)):
        plausible = rng.random() < 0.8
        field = rng.choice(list(PLAUSIBLE if plausible else images[0]))
        value = rng.choice(PLAUSIBLE[field] if plausible else OF_ANY_TYPE)
        together = field in OF_ALL_IMAGES or rng.random() < 0.3
        for image in images if together else [rng.choice(images)]:
            image[field] = value


@pytest.mark.long
@pytest.mark.parametrize("seed", [pytest.param(n, marks=() if n < 12 else pytest.mark.slow) for n in range(40)])
def test_a_dataset_with_wrong_fields_is_a_map_or_is_refused_with_a_reason(tmp_path: Path, seed: int) -> None:
    dataset(tmp_path)
    listing = json.loads((tmp_path / LISTING).read_text())
    changed(listing, random.Random(seed))
    (tmp_path / LISTING).write_text(json.dumps(listing))
    try:
        made = make_map(tmp_path, 0.05, VehicleConfig())
    except SurveyError as error:
        assert len(str(error)) > 20
    else:
        assert made.mosaic.seen.any() and made.save(tmp_path / "map.png")


@pytest.mark.parametrize("name", ["q_ned_from_camera", "q_ned_from_frd"])
@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (1, 1, 0, 0), (0.5, 0, 0, 0)])
def test_an_attitude_whose_length_is_not_1_is_named(tmp_path: Path, name: str, quaternion: tuple[float, ...]) -> None:
    dataset(tmp_path)
    listing = json.loads((tmp_path / LISTING).read_text())
    listing["images"][2][name] = quaternion
    (tmp_path / LISTING).write_text(json.dumps(listing))
    with pytest.raises(SurveyError, match=rf"{name} of 0002\.png is no attitude"):
        read_survey(tmp_path, VehicleConfig())
