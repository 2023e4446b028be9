"""Heights from a GeoTIFF of one's own: they become the terrain, and files that can't are refused with the reason."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from jezero.base.config import ConfigError
from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.terrain import make_terrain, steepest

ROWS, COLUMNS, PIXEL_M = 160, 180, 1.0
PROJECTED_METRES = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3076, 0, 1, 9001)


def ramp() -> Any:
    """Heights that rise to the north by 0.1 and to the east by 0.05; row 0 is the northernmost."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float32)
    return -2570.0 + 0.1 * (0.5 * (ROWS - 1) - row) + 0.05 * (column - 0.5 * (COLUMNS - 1))


def write(path: Path, heights_m: Any, keys: Any = PROJECTED_METRES, pixel_m: float = PIXEL_M, **tags: Any) -> Path:
    own = TiffImagePlugin.ImageFileDirectory_v2()
    if pixel_m:
        own.tagtype[33550] = own.tagtype[33922] = 12
        own[33550], own[33922] = (pixel_m, pixel_m, 0.0), (0.0, 0.0, 0.0, 1000.0, 2000.0, 0.0)
    if keys:
        own.tagtype[34735] = 3
        own[34735] = keys
    for tag, value in tags.items():
        own[int(tag[1:])] = value
    Image.fromarray(heights_m).save(path, tiffinfo=own)
    return path


def test_the_terrain_has_the_heights_of_the_file(tmp_path: Path) -> None:
    file = write(tmp_path / "place.tif", ramp())
    terrain = make_terrain(TerrainConfig(heights=str(file), rocks=0))
    assert terrain.height_m(0.0, 0.0) == pytest.approx(0.0, abs=1e-6)
    assert terrain.height_m(20.0, 0.0) == pytest.approx(2.0, abs=1e-3)
    assert terrain.height_m(-10.0, 30.0) == pytest.approx(-1.0 + 1.5, abs=1e-3)
    assert terrain.heights_m[0].tolist() == pytest.approx([0.0] * len(terrain.heights_m))
    north = make_terrain(TerrainConfig(heights=str(file), heights_north_m=10.0, rocks=0))
    assert north.height_m(5.0, 0.0) == pytest.approx(0.5, abs=1e-3)


def test_a_relative_path_begins_in_the_folder_of_the_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "place.tif", ramp())
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    assert make_terrain(TerrainConfig(heights="place.tif", rocks=0)).height_m(20.0, 0.0) == pytest.approx(2.0, abs=1e-3)


def test_whole_numbers_of_metres_are_heights_too(tmp_path: Path) -> None:
    file = write(tmp_path / "place.tif", np.rint(4.0 * (ramp() + 2570.0)).astype(np.int16))
    assert make_terrain(TerrainConfig(heights=str(file), rocks=0)).height_m(20.0, 0.0) == pytest.approx(8.0, abs=1.0)


def with_gap(value: float) -> Any:
    heights_m = ramp()
    heights_m[70:80, 70:80] = value
    return heights_m


@pytest.mark.parametrize(
    ("heights_m", "options", "settings", "reason"),
    [
        (ramp(), {"keys": None, "pixel_m": 0.0}, {}, "has no geographic tags"),
        (ramp(), {"keys": (1, 1, 0, 1, 1024, 0, 1, 2)}, {}, "counts in degrees"),
        (ramp(), {"keys": (1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9002)}, {}, "does not count in metres"),
        (ramp()[:100], {}, {}, "covers 100 m to the north and 180 m to the east"),
        (ramp(), {}, {"heights_east_m": 60.0}, "reaches beyond it"),
        (with_gap(-32768.0), {"t42113": "-32768"}, {}, "has no heights at 0.7 % of the terrain"),
        (with_gap(-3.4e38), {}, {}, "has no heights at"),
        (10.0 * ramp(), {}, {}, "the ground differs by"),
        (np.zeros((160, 180, 3), dtype=np.uint8), {}, {}, "is a picture in colours"),
    ],
)
def test_a_file_that_is_no_map_of_heights_is_refused(
    tmp_path: Path, heights_m: Any, options: dict[str, Any], settings: dict[str, Any], reason: str
) -> None:
    file = write(tmp_path / "place.tif", heights_m, **options)
    with pytest.raises(ConfigError, match=r"heights in simulator\.toml") as caught:
        make_terrain(TerrainConfig(heights=str(file), **settings))
    assert reason in str(caught.value)


def test_a_file_that_is_missing_or_no_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.tif"):
        make_terrain(TerrainConfig(heights=str(tmp_path / "nowhere.tif")))
    (tmp_path / "text.tif").write_text("no picture")
    with pytest.raises(ConfigError, match="is no GeoTIFF that can be read"):
        make_terrain(TerrainConfig(heights=str(tmp_path / "text.tif")))
    whole = write(tmp_path / "cut.tif", ramp()).read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ConfigError, match="is no GeoTIFF that can be read"):
        make_terrain(TerrainConfig(heights=str(tmp_path / "cut.tif")))


def test_a_crater_at_one_place_leaves_the_start_level() -> None:
    flat = TerrainConfig(std_ground_m=0.0, craters=0, rocks=0)
    config = TerrainConfig(
        std_ground_m=0.0, craters=0, rocks=0, basin_radius_m=15.0, basin_north_m=30.0, basin_east_m=-20.0
    )
    terrain = make_terrain(config)
    assert terrain.height_m(30.0, -20.0) == pytest.approx(-2.4, abs=0.05)
    assert terrain.height_m(30.0, -5.0) == pytest.approx(0.6, abs=0.1)
    assert abs(terrain.height_m(0.0, 0.0)) < 0.05
    assert steepest(terrain.heights_m) < 0.45
    assert np.abs(make_terrain(flat).heights_m).max() == 0.0
