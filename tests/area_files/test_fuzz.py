"""Damaged and strange files of every format: each gives an area, or a sentence that says what is wrong with it."""

import copy
import json
import zipfile
from collections.abc import Callable, Iterator
from io import BytesIO
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.area_files import AreaFileError, read_area
from jezero.area_files.area import DISTANCE_MAX_M
from tests.area_files.samples import EXAMPLES, ORIGIN_DEG, POLYGON

LIMITS = settings(max_examples=50, deadline=5000)
BESIDE = (".dbf", ".prj", ".shx")
MAIN_FILES = sorted(file.name for file in EXAMPLES.iterdir() if file.suffix not in BESIDE)
SHAPEFILE = sorted(file.name for file in EXAMPLES.glob("field.*") if file.suffix in {".shp", *BESIDE})
WORDS = (
    "", "nan", "inf", "-1e308", "1e999", "1_0", "0x1f", "٣", "8,5", "47°23'", "lat", "latitude", "lon", "north", "x",
    "east (m)", '"', "'", "\0", "\ufeff", "\u2028", "<", "</Polygon>", "<coordinates>", "&", "%", "NaN", "null",
)  # fmt: skip
NASTY = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.sampled_from(WORDS),
    st.sampled_from(
        ("Polygon", "MultiPolygon", "FeatureCollection", "GeometryCollection", "Feature", "Plan", "survey")
    ),
    st.sampled_from(([], {}, [[]], [[[]]], [[0, 0]] * 4, [[1e300, -1e300], [0, 1], [1, 0]])).map(copy.deepcopy),
)
JSON = st.recursive(NASTY, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
    st.sampled_from(("type", "coordinates", "features", "geometry", "geometries", "crs", "properties", "name", "id",
                     "fileType", "mission", "items", "polygon", "geoFence", "polygons", "circles", "circle", "radius")),
    inner, max_size=4), max_leaves=12)  # fmt: skip
DOCUMENTS: dict[str, Any] = {
    "area.geojson": {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": "EPSG:4326"}},
        "features": [
            {"type": "Feature", "properties": {"name": "a"}, "geometry": POLYGON},
            {"type": "Feature", "id": 7, "geometry": {"type": "MultiPolygon", "coordinates": [POLYGON["coordinates"]]}},
        ],
    },
    "area.plan": json.loads((EXAMPLES / "field.plan").read_text()),
}


def check(folder: Path, name: str, *, metres: bool = False, feature: str | None = None) -> None:
    """The file is an area near the origin, or is refused in one line that names it; nothing else is raised."""
    try:
        area = read_area(folder / name, ORIGIN_DEG, metres=metres, feature=feature)
    except AreaFileError as error:
        text = str(error)
        assert text.startswith(str(folder / name)) and "\n" not in text and len(text) < 3000
        return
    for ring in (area.polygon_ned_m, *area.holes_ned_m):
        assert len(set(ring)) >= 3
        assert all(isfinite(value) for corner in ring for value in corner)
    assert all(abs(value) <= DISTANCE_MAX_M for corner in area.polygon_ned_m for value in corner)


def check_content(name: str, data: bytes, **options: Any) -> None:
    with TemporaryDirectory() as folder:
        (Path(folder) / name).write_bytes(data)
        check(Path(folder), name, **options)


@st.composite
def damaged(draw: Callable[..., Any], data: bytes) -> bytes:
    """A file after some mishaps: bytes changed, cut out, repeated or added, or its end missing."""
    for _ in range(draw(st.integers(1, 6))):
        start = draw(st.integers(0, len(data)))
        end = min(len(data), start + draw(st.sampled_from((0, 1, 2, 4, 8, 40))))
        inserted = draw(
            st.one_of(st.binary(max_size=8), st.sampled_from(WORDS).map(str.encode), st.just(data[start:end] * 2))
        )
        data = data[:start] + inserted + data[end:]
    return data[: draw(st.integers(0, len(data)))] if draw(st.integers(0, 4)) == 0 else data


@pytest.mark.parametrize("name", MAIN_FILES)
@given(st.data())
@LIMITS
def test_no_damage_to_a_file_raises_anything_but_a_sentence(name: str, data: st.DataObject) -> None:
    content = data.draw(damaged((EXAMPLES / name).read_bytes()))
    metres = data.draw(st.booleans())
    check_content(name, content, metres=metres, feature=data.draw(st.sampled_from((None, "1", "2", "orchard"))))


@pytest.mark.long
@pytest.mark.parametrize("name", SHAPEFILE)
@given(st.data())
@LIMITS
def test_no_damage_to_one_file_of_a_shapefile_raises_anything_but_a_sentence(name: str, data: st.DataObject) -> None:
    content = data.draw(damaged((EXAMPLES / name).read_bytes()))
    with TemporaryDirectory() as folder:
        for each in SHAPEFILE:
            (Path(folder) / each).write_bytes(content if each == name else (EXAMPLES / each).read_bytes())
        check(Path(folder), "field.shp")


@given(st.data())
@LIMITS
def test_no_damage_to_the_document_in_an_archive_raises_anything_but_a_sentence(data: st.DataObject) -> None:
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("doc.kml", data.draw(damaged((EXAMPLES / "field.kml").read_bytes())))
    check_content("area.kmz", packed.getvalue())


def places_in(container: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of a document at any depth: what holds it, and its key or index there."""
    if not isinstance(container, dict | list):
        return
    for key in container if isinstance(container, dict) else range(len(container)):
        yield container, key
        yield from places_in(container[key])


@pytest.mark.parametrize("name", DOCUMENTS)
@given(st.data())
@LIMITS
def test_no_value_of_another_kind_in_a_document_raises_anything_but_a_sentence(name: str, data: st.DataObject) -> None:
    document = copy.deepcopy(DOCUMENTS[name])
    for _ in range(data.draw(st.integers(1, 3))):
        container, key = data.draw(st.sampled_from(list(places_in(document))))
        container[key] = data.draw(NASTY)
    check_content(name, json.dumps(document).encode(), feature=data.draw(st.sampled_from((None, "1", "a"))))


@pytest.mark.parametrize("name", DOCUMENTS)
@given(content=JSON, metres=st.booleans())
@LIMITS
def test_no_document_of_known_words_raises_anything_but_a_sentence(name: str, content: Any, metres: bool) -> None:
    check_content(name, json.dumps(content).encode(), metres=metres)


@given(
    lines=st.lists(st.lists(st.sampled_from(WORDS) | st.floats().map(str) | st.integers(-90, 90).map(str), max_size=5)),
    separator=st.sampled_from((",", ";", "\t", " ", ", ", "|")),
    headings=st.sampled_from(("", "latitude,longitude", "east;north", "lon lat", "x\ty", "north,east,north", "a,b")),
    metres=st.booleans(),
)
@LIMITS
def test_no_table_raises_anything_but_a_sentence(
    lines: list[list[str]], separator: str, headings: str, metres: bool
) -> None:
    text = "\n".join([headings, *(separator.join(words) for words in lines)])
    check_content("area.csv", text.encode(), metres=metres)


@pytest.mark.parametrize("kind", ["csv", "txt", "json", "geojson", "kml", "kmz", "plan", "shp"])
@given(data=st.binary(max_size=400))
@LIMITS
def test_no_bytes_at_all_raise_anything_but_a_sentence(kind: str, data: bytes) -> None:
    check_content(f"area.{kind}", data)
