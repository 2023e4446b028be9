"""Files of all formats: the examples of the documentation, the choice of an area, and what is missing."""

import sys
from pathlib import Path

import pytest

from jezero.area_files import AreaFileError, read_area
from tests.area_files.samples import EXAMPLES, ORCHARD, ORIGIN_DEG, TREE, same, sentence

EXAMPLE_FILES = sorted(file for file in EXAMPLES.iterdir() if file.suffix not in {".dbf", ".prj", ".shx"})


@pytest.mark.parametrize("example", EXAMPLE_FILES, ids=lambda file: file.name)
def test_the_example_of_every_format_is_the_same_area(example: Path) -> None:
    area = read_area(example, ORIGIN_DEG, metres=example.name == "field_in_metres.geojson")
    assert same(area, ORCHARD, [TREE])


@pytest.mark.parametrize(
    ("package", "name", "why"),
    [
        ("defusedxml.ElementTree", "field.kml", r"needs defusedxml, an extra: pip install 'jezero\[cli\]'"),
        ("shapefile", "field.shp", r"needs pyshp, an extra: pip install 'jezero\[cli\]'"),
        ("pyproj", "field.shp", r"by pyproj, which is an extra: pip install 'jezero\[gis\]'"),
    ],
)
def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, package: str, name: str, why: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(AreaFileError, match=why):
        read_area(EXAMPLES / name, ORIGIN_DEG)


def test_a_file_that_cannot_be_read_or_has_another_format_is_named(tmp_path: Path) -> None:
    with pytest.raises(AreaFileError, match=r"missing.kml can't be read: No such file"):
        read_area(tmp_path / "missing.kml", ORIGIN_DEG)
    assert 'its name ends in ".gpkg": known are .csv, ' in sentence(tmp_path, "area.gpkg", "")
    assert "its name has no ending: known are .csv, " in sentence(tmp_path, "area", "0,0")
    assert ".kml files are never in [north, east] metres" in sentence(tmp_path, "area.kml", "", metres=True)
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(60_000_000)
    with pytest.raises(AreaFileError, match="has more than 50 MB: export the one field only"):
        read_area(tmp_path / "large.csv", ORIGIN_DEG)


@pytest.mark.parametrize("ending", ["csv", "txt", "json", "geojson", "kml", "kmz", "plan", "shp"])
def test_an_empty_file_is_called_empty_in_every_format(tmp_path: Path, ending: str) -> None:
    assert sentence(tmp_path, f"area.{ending}", "").endswith("is empty: export the area again")


@pytest.mark.parametrize("ending", ["csv", "txt", "json", "geojson", "kml", "kmz", "plan", "shp"])
def test_a_file_of_bytes_is_refused_in_words_about_files(tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"area.{ending}"
    file.write_bytes(bytes(range(255, 0, -1)) * 8)
    with pytest.raises(AreaFileError, match=r"is no text in UTF-8|is not (KML|a KMZ archive|a shapefile) that can"):
        read_area(file, ORIGIN_DEG)
