"""Shapefiles: what is read, and the sentences for what is not."""

import sys
from pathlib import Path
from typing import Any

import pytest
import shapefile
from pyproj import CRS, Transformer

from jezero.area_files import AreaFileError, read_area
from tests.area_files.samples import FIELD, ORCHARD, ORIGIN_DEG, TREE, geojson, same, sentence


def write_shapes(
    file: Path, *shapes: Any, names: tuple[str, ...] = ("north", "south"), kind: int = shapefile.POLYGON
) -> Path:
    with shapefile.Writer(str(file), shapeType=kind) as writer:
        writer.field("name", "C", 20)
        for shape, name in zip(shapes, names, strict=False):
            writer.null() if shape is None else writer.poly(shape)
            writer.record(name)
    return file


def test_shapes_are_named_and_those_without_corners_left_out(tmp_path: Path) -> None:
    file = write_shapes(tmp_path / "area.shp", None, [geojson(FIELD)])
    area = read_area(file, ORIGIN_DEG)
    assert area.name == "south" and sorted(area.polygon_ned_m)[0] == pytest.approx((0.0, 0.0), abs=0.001)
    (tmp_path / "area.dbf").unlink()
    (tmp_path / "area.shx").unlink()
    assert len(read_area(file, ORIGIN_DEG).polygon_ned_m) == 4


@pytest.mark.parametrize("directions", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_ring_inside_another_is_a_hole_whatever_their_directions_are(
    tmp_path: Path, directions: tuple[int, int]
) -> None:
    file = write_shapes(
        tmp_path / "area.shp", [geojson(TREE)[:: directions[0]], geojson(ORCHARD)[:: directions[1]]], names=("a",)
    )
    area = read_area(file, ORIGIN_DEG)
    assert same(area, ORCHARD, [TREE])


def test_a_shape_with_two_outlines_is_two_areas(tmp_path: Path) -> None:
    far = [(100.0, 0.0), (100.0, 20.0), (110.0, 20.0)]
    file = write_shapes(tmp_path / "area.shp", [geojson(FIELD), geojson(far)], names=("a",))
    with pytest.raises(AreaFileError, match=r"has 2 areas, .*: 1 a \(1050 m²\), 2 a \(100 m²\)"):
        read_area(file, ORIGIN_DEG)


def test_a_shapefile_is_in_the_coordinates_of_its_prj_file(tmp_path: Path) -> None:
    swiss = Transformer.from_crs("EPSG:4326", "EPSG:2056", always_xy=True)
    file = write_shapes(tmp_path / "area.shp", [[swiss.transform(corner[0], corner[1]) for corner in geojson(FIELD)]])
    with pytest.raises(AreaFileError, match="is not longitude and latitude, and no"):
        read_area(file, ORIGIN_DEG)
    (tmp_path / "area.prj").write_text(CRS("EPSG:2056").to_wkt("WKT1_ESRI"))
    assert same(read_area(file, ORIGIN_DEG), FIELD)
    (tmp_path / "area.prj").write_text("nonsense")
    with pytest.raises(AreaFileError, match='its coordinate system "nonsense" is not known'):
        read_area(file, ORIGIN_DEG)


def test_a_shapefile_in_wgs_84_needs_no_pyproj(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    file = write_shapes(tmp_path / "area.shp", [geojson(FIELD)])
    (tmp_path / "area.prj").write_text(CRS("EPSG:4326").to_wkt("WKT1_ESRI"))
    assert len(read_area(file, ORIGIN_DEG).polygon_ned_m) == 4


def test_names_in_an_old_encoding_do_not_stop_a_shapefile(tmp_path: Path) -> None:
    file = write_shapes(tmp_path / "area.shp", [geojson(FIELD)], names=("Hof",))
    data = (tmp_path / "area.dbf").read_bytes()
    (tmp_path / "area.dbf").write_bytes(data.replace(b"Hof", b"H\xf6f"))
    assert read_area(file, ORIGIN_DEG).name.startswith("H")


def test_what_is_no_shapefile_with_areas_is_refused(tmp_path: Path) -> None:
    with shapefile.Writer(str(tmp_path / "area.shp"), shapeType=shapefile.POINT) as writer:
        writer.field("name", "C", 20)
        writer.point(8.5, 47.4)
        writer.record("tree")
    with pytest.raises(AreaFileError, match="has shapes of type POINT instead of polygons"):
        read_area(tmp_path / "area.shp", ORIGIN_DEG)
    with pytest.raises(AreaFileError, match="has no shapes"):
        read_area(write_shapes(tmp_path / "none.shp"), ORIGIN_DEG)
    assert "is not a shapefile that can be read" in sentence(tmp_path, "text.shp", "no shapefile")
