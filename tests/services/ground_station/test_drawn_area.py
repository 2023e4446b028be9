"""The area of a browser: its file, and its place on the globe."""

import json

import pytest

from jezero.area_files import AreaFileError
from jezero.base.frames import geodetic_from_ned
from jezero.services.ground_station.drawn_area import DrawnArea, area_from_browser, placed, polygons_in

ORIGIN_DEG = (18.4447, 77.4508)
OUTLINE = [[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0]]
HOLE = [[5.0, 4.0], [8.0, 4.0], [8.0, 7.0]]
DRAWN = DrawnArea((OUTLINE, HOLE), ORIGIN_DEG)


def test_an_exported_area_is_imported_as_it_was() -> None:
    text = DRAWN.geojson().decode()
    assert json.loads(text)["geometry"]["type"] == "Polygon"
    (polygon,) = polygons_in("area.geojson", text, len(text))
    again = placed(polygon, ORIGIN_DEG)
    assert len(again.rings) == 2
    for ring, expected in zip(again.rings, (OUTLINE, HOLE), strict=True):
        for corner, corner_m in zip(ring, expected, strict=True):
            assert corner == pytest.approx(corner_m, abs=0.002)


def test_an_area_stays_where_it_is_on_the_globe_when_the_origin_moves() -> None:
    latitude, longitude, _ = geodetic_from_ned((3.0, -2.0, 0.0), (*ORIGIN_DEG, 0.0))
    moved = DRAWN.around((latitude, longitude))
    assert moved.outline[1] == pytest.approx([17.0, 2.0], abs=1e-3)
    assert moved.origin_deg == (latitude, longitude)
    assert DRAWN.around(ORIGIN_DEG) is DRAWN
    assert DRAWN.around(None) is DRAWN


def test_an_area_that_was_drawn_before_the_origin_was_known_gets_it() -> None:
    assert DrawnArea((OUTLINE,)).around(ORIGIN_DEG) == DrawnArea((OUTLINE,), ORIGIN_DEG)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("area.geojson", "{", "area.geojson: line 1"),
        ("area.geojson", '{"type": "Point", "coordinates": [1, 2]}', "has no GeoJSON Polygon"),
        ("area.geojson", "[[0, 0], [1, 0], [1, 1]]", "fly it with `jezero gridsweep --metres`"),
        ("area.exe", "x", "known are"),
        ("area", "", "has no ending"),
    ],
)
def test_a_file_without_an_area_is_refused_with_what_is_wrong(name: str, text: str, said: str) -> None:
    with pytest.raises(AreaFileError) as caught:
        polygons_in(name, text, len(text))
    assert said in str(caught.value)
    assert "/tmp" not in str(caught.value)


@pytest.mark.parametrize("claimed_bytes", [600_000, 1])
def test_a_file_that_is_too_large_is_refused_with_its_size(claimed_bytes: int) -> None:
    text = "" if claimed_bytes > 1 else "x" * 600_000
    with pytest.raises(AreaFileError, match=r"has 0\.6 MB, more than 0\.5 MB"):
        polygons_in("area.geojson", text, claimed_bytes)


@pytest.mark.parametrize(
    "sent", [None, 7, [], [[]], [[["a", 0]]], [[[1e9, 0]]], [[[float("nan"), 0.0]]], [[[0.0] * 3]]]
)
def test_what_is_no_area_is_an_empty_one(sent: object) -> None:
    assert area_from_browser(sent).rings == ()


def test_nothing_is_exported_without_an_area_or_an_origin() -> None:
    with pytest.raises(AreaFileError, match="origin"):
        DrawnArea((OUTLINE,)).geojson()
    with pytest.raises(AreaFileError, match="draw one"):
        DrawnArea((), ORIGIN_DEG).geojson()


def test_an_area_relative_to_the_rover_is_counted_from_its_position() -> None:
    outline, hole = DRAWN.relative_to((5.0, 4.0, -0.5))
    assert outline[2] == [15.0, 6.0]
    assert hole[0] == [0.0, 0.0]
