"""The area in the world: where the origin puts it, and numbers that must be misread."""

from math import nan
from pathlib import Path
from typing import Any

import pytest

from jezero.area_files import AreaFileError, FilePolygon, place, read_area
from jezero.base.frames import ned_from_geodetic
from tests.area_files.samples import FIELD, ORIGIN_DEG, POLYGON, degrees, geojson, near, read, sentence

FAR = {"type": "Polygon", "coordinates": [geojson([(100.0, 0.0), (100.0, 20.0), (110.0, 20.0)])]}
LAT_LON = tuple((corner[0], corner[1]) for corner in degrees(FIELD))


def feature(geometry: Any, name: str = "") -> dict[str, Any]:
    return {"type": "Feature", "properties": {"name": name}, "geometry": geometry}


def collection(*features: Any) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(features)}


def test_the_same_file_around_another_origin_is_that_much_farther_away(tmp_path: Path) -> None:
    (tmp_path / "area.csv").write_text("lat,lon\n" + "\n".join(f"{a},{b}" for a, b in LAT_LON))
    here = read_area(tmp_path / "area.csv", ORIGIN_DEG).polygon_ned_m
    south_west_deg = (ORIGIN_DEG[0] - 0.001, ORIGIN_DEG[1] - 0.001)
    there = read_area(tmp_path / "area.csv", (*south_west_deg, 488.0)).polygon_ned_m
    north_m, east_m, _ = ned_from_geodetic((*ORIGIN_DEG, 0.0), (*south_west_deg, 0.0))
    assert near(there, [(north + north_m, east + east_m) for north, east in here], 0.02)


def test_an_area_knows_the_origin_that_placed_it_if_its_file_was_in_degrees(tmp_path: Path) -> None:
    (tmp_path / "area.csv").write_text("lat,lon\n" + "\n".join(f"{a},{b}" for a, b in LAT_LON))
    assert read_area(tmp_path / "area.csv", (*ORIGIN_DEG, 488.0)).origin_deg == ORIGIN_DEG
    (tmp_path / "metres.csv").write_text("north,east\n0,0\n0,9\n9,9\n")
    assert read_area(tmp_path / "metres.csv", ORIGIN_DEG).origin_deg is None


def test_an_area_across_the_antimeridian_is_whole() -> None:
    ring = ((-17.0, 179.9999), (-17.0, -179.9999), (-16.9999, -179.9999))
    area = place(FilePolygon("", "area", (ring,)), (-17.0, 180.0))
    assert near(area.polygon_ned_m, [(0.0, -10.63), (0.0, 10.63), (11.12, 10.63)], 0.01)


@pytest.mark.parametrize(
    ("ring", "options", "why"),
    [
        (
            ((46.0, 8.0), (46.1, 8.0), (46.0, 8.1)),
            {},
            "latitude 46.000000, longitude 8.000000 is 161 km from the world",
        ),
        (((46.0, 8.0), (46.1, 8.0), (46.0, 8.1)), {}, "which is at 47.397742, 8.545594: if the field is elsewhere"),
        (((8.5, 47.4), (8.6, 47.4), (8.6, 47.5)), {}, "latitude and longitude are in the wrong order"),
        (
            ((0.0, 0.0), (0.0, 4.0), (4.0, 4.0)),
            {"perhaps_metres": True},
            "if its numbers are metres, [north, east], add",
        ),
        (((120.0, 8.0), (0.0, 4.0), (4.0, 4.0)), {}, "is not on Earth: degrees are WGS 84, the latitude up to 90"),
        (
            ((120.0, 8.0), (0.0, 4.0), (4.0, 4.0)),
            {"perhaps_metres": True},
            "is not on Earth: if its numbers are metres",
        ),
        (((5249465.0, 465765.0), (0.0, 4.0), (4.0, 4.0)), {"in_metres": True}, "not from that of a map"),
        (((47.0, 8.0), (47.0001, 8.0), (47.0, 8.0001)), {"in_metres": True}, "0.1 mm wide: if its numbers are degrees"),
        (((47.4, 8.5), (47.4, 8.5000001), (47.4000001, 8.5)), {}, "the area is only 11.1 mm wide"),
    ],
)
def test_an_area_whose_numbers_must_be_misread_is_refused_with_a_hint(ring: Any, options: Any, why: str) -> None:
    with pytest.raises(AreaFileError) as refused:
        place(FilePolygon("", "area.csv, the outline", (ring,), **options), ORIGIN_DEG)
    assert why in str(refused.value) and str(refused.value).startswith("area.csv, the outline: ")


def test_degrees_need_an_origin_that_is_a_place(tmp_path: Path) -> None:
    with pytest.raises(AreaFileError, match="the world's origin is not known yet"):
        place(FilePolygon("", "area", (LAT_LON,)), None)
    with pytest.raises(AreaFileError):
        place(FilePolygon("", "area", (LAT_LON,)), (nan, nan))
    assert place(FilePolygon("", "area", (FIELD,), in_metres=True), None).polygon_ned_m == FIELD


def test_a_file_with_several_areas_is_refused_with_their_names_and_sizes(tmp_path: Path) -> None:
    content = collection(feature(POLYGON, "north"), feature({"type": "Point", "coordinates": [8, 47]}), feature(FAR))
    chosen = "has 2 areas, choose one with --feature NUMBER or NAME: 1 north (1050 m²), 2 (100 m²)"
    assert sentence(tmp_path, "area.geojson", content) == chosen
    parts = {"type": "MultiPolygon", "coordinates": [POLYGON["coordinates"], FAR["coordinates"]]}
    assert sentence(tmp_path, "area.geojson", parts).startswith("has 2 areas, choose one with --feature")
    many = collection(*[feature(FAR, f"field {number}") for number in range(400)])
    assert sentence(tmp_path, "area.geojson", many).endswith("20 field 19 (100 m²), and 380 more")


def test_several_areas_in_degrees_are_not_taken_for_metres(tmp_path: Path) -> None:
    far = {"type": "MultiPolygon", "coordinates": [[[[8.0, 47.0], [8.0, 47.0001], [8.0001, 47.0]]]] * 2}
    assert "if its numbers are degrees, leave out --metres" in sentence(tmp_path, "two.geojson", far, metres=True)


def test_a_corner_without_bounds_is_refused_in_a_short_sentence(tmp_path: Path) -> None:
    refused = sentence(tmp_path, "huge.csv", "north,east\n0,0\n1e300,0\n1e300,1e300\n")
    assert "is 1.0e+297 km from the world's origin" in refused
    assert len(refused) < 300


def test_an_area_is_chosen_by_name_or_by_number(tmp_path: Path) -> None:
    content = collection(feature(POLYGON, "north"), feature(FAR, "3"), feature(FAR, "double"), feature(FAR, "double"))
    assert read(tmp_path, "area.geojson", content, feature="north").name == "north"
    assert read(tmp_path, "area.geojson", content, feature=1).name == "north"
    assert read(tmp_path, "area.geojson", content, feature="4").name == "double"
    assert read(tmp_path, "area.geojson", content, feature="3").name == "3"
    double = sentence(tmp_path, "area.geojson", content, feature="double")
    assert double.startswith('has 2 areas "double", choose one with --feature NUMBER: 1 north (1050 m²), 2 3 (100')
    for feature_name in ("south", "5", "0", "-1", "²"):
        missing = sentence(tmp_path, "area.geojson", content, feature=feature_name)
        assert missing.startswith(f'has no area "{feature_name}", but 1 north (1050 m²), 2 3')


def test_a_hole_counts_neither_for_the_size_nor_for_the_distance(tmp_path: Path) -> None:
    hole = geojson([(10.0, 15.0), (10.0, 20.0), (14.0, 20.0)])
    content = {"type": "Polygon", "coordinates": [*POLYGON["coordinates"], hole]}
    assert "1 (1040 m²)" in sentence(tmp_path, "area.geojson", content, feature="none")
