"""GeoJSON files: what is read, and the sentences for what is not."""

from pathlib import Path
from typing import Any

import pytest
from pyproj import Transformer

from tests.area_files.samples import FIELD, NAMED, POLYGON, geojson, near, read, sentence


@pytest.mark.parametrize(
    "content",
    [
        POLYGON,
        {"type": "MultiPolygon", "coordinates": [POLYGON["coordinates"]]},
        {**NAMED, "geometry": POLYGON},
        {"type": "FeatureCollection", "features": [{**NAMED, "geometry": POLYGON}]},
        {"type": "GeometryCollection", "geometries": [{"type": "Point", "coordinates": [8.5, 47.4]}, POLYGON]},
        {
            "type": "FeatureCollection",
            "features": [{"type": "Feature", "geometry": None}, {**NAMED, "geometry": POLYGON}],
        },
        {**POLYGON, "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}},
        {"type": "Polygon", "coordinates": [[[*corner, 488.0] for corner in geojson(FIELD)]]},
    ],
    ids=["polygon", "multipolygon", "feature", "collection", "geometries", "empty feature", "crs", "altitude"],
)
def test_every_kind_of_geojson_with_one_area_is_read_as_longitude_and_latitude(tmp_path: Path, content: Any) -> None:
    area = read(tmp_path, "area.geojson", content)
    assert near(area.polygon_ned_m, FIELD)


def test_a_feature_gives_the_area_its_name(tmp_path: Path) -> None:
    assert read(tmp_path, "area.json", {**NAMED, "geometry": POLYGON}).name == "north"
    assert read(tmp_path, "area.json", {"type": "Feature", "id": 7, "geometry": POLYGON}).name == "7"


def test_coordinates_in_utm_are_converted(tmp_path: Path) -> None:
    utm = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True)
    corners = [list(utm.transform(corner[0], corner[1])) for corner in geojson(FIELD)]
    system = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}
    area = read(tmp_path, "area.geojson", {"type": "Polygon", "coordinates": [corners], "crs": system})
    assert near(area.polygon_ned_m, FIELD)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("{", "line 1, column 2 is not JSON"),
        (b"\xff\xfe{\x00", "is no text in UTF-8: save it as UTF-8"),
        ("1" * 5000, "a number with too many digits"),
        ("[" * 100_000, "is nested too deeply"),
        ("5", '"5" is not a GeoJSON object'),
        ([[0, 0], [0, 4], [4, 4]], "is a plain list of corners, which is in metres, [north, east]: add --metres"),
        ({}, "has no GeoJSON Polygon or MultiPolygon: it has None"),
        ({"type": []}, "has no GeoJSON Polygon or MultiPolygon: it has []"),
        ({"type": "LineString", "coordinates": []}, "has no GeoJSON Polygon or MultiPolygon: it has LineString"),
        ({"type": "FeatureCollection"}, 'the FeatureCollection has no list "features"'),
        ({"type": "FeatureCollection", "features": [3]}, 'feature 1: "3" is not a GeoJSON object'),
        ({"type": "Polygon"}, "Polygon: its coordinates are not a list of rings"),
        ({"type": "MultiPolygon", "coordinates": 1}, "MultiPolygon: its coordinates are not a list of polygons"),
        ({"type": "Polygon", "coordinates": [7]}, 'Polygon, ring 1: "7" is not a list of corners'),
        ({"type": "Polygon", "coordinates": [[["a"]]]}, "ring 1, corner 1: \"['a']\" is not [longitude, latitude]"),
        ('{"type": "Polygon", "coordinates": [[[8.5, NaN]]]}', 'corner 1: "[8.5, nan]" is not [longitude, latitude]'),
        ('{"type": "Polygon", "coordinates": [[[8.5, 1e999]]]}', 'corner 1: "[8.5, inf]" is not'),
        ({"type": "Polygon", "coordinates": [[[8.5, True]]]}, 'corner 1: "[8.5, True]" is not'),
        ({"type": "Polygon", "coordinates": [[[8.5, 10**400]]]}, "corner 1:"),
        ({"type": "Polygon", "coordinates": [[[8, 47], [8, 48], [8, 47]]]}, "ring 1 has 2 corners, and an area needs"),
        ({**POLYGON, "crs": {}}, 'the coordinate system (crs) "{}" has no name'),
        ({**POLYGON, "crs": {"properties": {"name": "Mars"}}}, 'its coordinate system "Mars" is not known'),
    ],
)
def test_what_is_no_geojson_area_is_refused_with_its_place(tmp_path: Path, content: Any, why: str) -> None:
    assert why in sentence(tmp_path, "area.geojson", content)


def test_metres_in_geojson_are_north_and_east_and_must_be_said_to_be_metres(tmp_path: Path) -> None:
    square = {"type": "Polygon", "coordinates": [[[0, 0], [0, 8], [4, 8], [4, 0], [0, 0]]]}
    assert read(tmp_path, "area.json", square, metres=True).polygon_ned_m == ((0, 0), (0, 8), (4, 8), (4, 0))
    assert "if its numbers are metres, [north, east], add --metres" in sentence(tmp_path, "area.json", square)
    plain = [[0, 0], [0, 8], [4, 8], [4, 0]]
    assert read(tmp_path, "area.json", plain, metres=True).polygon_ned_m == ((0, 0), (0, 8), (4, 8), (4, 0))
    system = {**square, "crs": {"properties": {"name": "EPSG:4326"}}}
    assert "leave out --metres" in sentence(tmp_path, "area.json", system, metres=True)
