"""A map's files say where it is, to programs that know nothing of jezero."""

import json
from math import cos, radians
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner
from PIL import Image as Pillow
from pyproj import CRS, Transformer

from jezero.base.frames import EARTH_RADIUS_M, Vec3, geodetic_from_ned
from jezero.cli.main import main
from jezero.mapping.files import projection_wkt
from tests.mapping.painted_ground import change_images, dataset

MILLIMETRE_DEG = 1e-8
ORIGINS_DEG = [(47.397742, 8.545594, 488.0), (-33.9, -70.25, 520.0), (0.0, 0.0, 0.0), (69.6, 18.9, -3.0)]
SCALE, TIEPOINT, KEYS, DESCRIPTION = 33550, 33922, 34735, 270


def with_map(folder: Path, origin_deg: Vec3 | None) -> dict[str, Any]:
    """The result of `jezero map --json` for a dataset whose images have positions in degrees."""
    dataset(folder)

    def change(image: dict[str, Any]) -> None:
        if origin_deg is not None:
            image["position_camera_deg"] = geodetic_from_ned(image["pos_camera_ned_m"], origin_deg)

    change_images(folder, change)
    result = CliRunner().invoke(main, ["map", str(folder), "--resolution", "0.05", "--json"])
    assert result.exit_code == 0, result.output
    told: dict[str, Any] = json.loads(result.output)
    return told


def first_pixel_m(folder: Path) -> tuple[float, float]:
    """North and east of the north-western edge of the first pixel, from the world file."""
    numbers = [float(line) for line in (folder / "map.pgw").read_text().split()]
    return numbers[5] - 0.5 * numbers[3], numbers[4] - 0.5 * numbers[0]


@pytest.mark.parametrize("origin_deg", ORIGINS_DEG)
def test_the_geotiff_is_where_the_world_file_and_the_origin_put_it(tmp_path: Path, origin_deg: Vec3) -> None:
    told = with_map(tmp_path, origin_deg)
    assert told["origin_deg"] == pytest.approx(origin_deg, abs=MILLIMETRE_DEG)
    with Pillow.open(tmp_path / "map.tif") as picture, Pillow.open(tmp_path / "map.png") as png:
        tags: Any = picture.tag_v2  # type: ignore[attr-defined]
        assert picture.mode == "RGBA" and picture.tobytes() == png.tobytes()
    north_m, east_m = first_pixel_m(tmp_path)
    latitude, longitude, _ = geodetic_from_ned((north_m, east_m, 0.0), origin_deg)
    assert tags[TIEPOINT] == pytest.approx((0.0, 0.0, 0.0, longitude, latitude, 0.0), abs=MILLIMETRE_DEG)
    north_deg = 0.05 / radians(1.0) / EARTH_RADIUS_M
    assert tags[SCALE] == pytest.approx((north_deg / cos(radians(origin_deg[0])), north_deg, 0.0), rel=1e-6)
    keys = dict(zip(tags[KEYS][4::4], tags[KEYS][7::4], strict=True))
    assert keys == {1024: 2, 1025: 1, 2048: 4326, 2054: 9102}
    assert tags[DESCRIPTION] == "jezero map: 5 cm per pixel; its 6 images have 3.6 cm per pixel"


@pytest.mark.parametrize("origin_deg", ORIGINS_DEG)
def test_the_overlay_has_the_edges_of_the_picture(tmp_path: Path, origin_deg: Vec3) -> None:
    with_map(tmp_path, origin_deg)
    overlay = ElementTree.parse(tmp_path / "map.kml").getroot()
    space = {"kml": "http://www.opengis.net/kml/2.2"}
    assert overlay.findtext(".//kml:href", namespaces=space) == "map.png"
    with Pillow.open(tmp_path / "map.png") as picture:
        columns, rows = picture.size
    north_m, west_m = first_pixel_m(tmp_path)
    for names, place_m in (
        (("north", "west"), (north_m, west_m, 0.0)),
        (("south", "east"), (north_m - 0.05 * rows, west_m + 0.05 * columns, 0.0)),
    ):
        edges = [float(overlay.findtext(f".//kml:LatLonBox/kml:{name}", "nan", space)) for name in names]
        assert edges == pytest.approx(geodetic_from_ned(place_m, origin_deg)[:2], abs=MILLIMETRE_DEG)


@pytest.mark.parametrize("origin_deg", ORIGINS_DEG)
def test_the_projection_turns_metres_of_the_world_frame_into_degrees(origin_deg: Vec3) -> None:
    projection = CRS.from_wkt(projection_wkt(origin_deg))
    north_m, east_m = 120.0, -45.0
    longitude, latitude = Transformer.from_crs(projection, projection.geodetic_crs, always_xy=True).transform(
        east_m, north_m
    )
    assert (latitude, longitude) == pytest.approx(
        geodetic_from_ned((north_m, east_m, 0.0), origin_deg)[:2], abs=MILLIMETRE_DEG
    )


def test_a_map_without_positions_in_degrees_has_only_files_in_metres_and_says_so(tmp_path: Path) -> None:
    told = with_map(tmp_path, None)
    assert [Path(file).name for file in told["files"]] == ["map.png", "map.pgw"] and told["origin_deg"] is None
    result = CliRunner().invoke(main, ["map", str(tmp_path), "--resolution", "0.02"])
    assert "no position in degrees, so there is no GeoTIFF and no KML" in result.output
    assert "2 cm per pixel, finer than its images; its 6 images have 3.6 cm per pixel" in result.output
