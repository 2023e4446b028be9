"""Areas that cross the meridian of 180°, in every format: the same field, wherever the vehicle's origin is."""

import json
from pathlib import Path
from typing import Any

import pytest
import shapefile

from jezero.area_files import read_area
from jezero.area_files.rings import ring_area
from jezero.mission_files import read_fence, read_mission

WEST, EAST, SOUTH, NORTH = 179.9999, -179.9998, -17.0, -16.9998
RING = [[WEST, SOUTH], [EAST, SOUTH], [EAST, NORTH], [WEST, NORTH], [WEST, SOUTH]]
HOLE = [[179.99993, -16.9999], [179.99997, -16.9999], [179.99997, -16.99985], [179.99993, -16.9999]]
"""West of the meridian."""
SIZE_M2, HOLE_M2 = 32.0 * 22.2, 0.5 * 4.25 * 5.56
ORIGINS = [(-17.0, 180.0), (-17.0, -180.0), (-16.999, 179.999), (-17.001, -179.999)]


def beyond(ring: list[list[float]]) -> list[list[float]]:
    return [[longitude % 360.0, latitude] for longitude, latitude in ring]


def swapped(ring: list[list[float]]) -> list[list[float]]:
    return [[latitude, longitude] for longitude, latitude in ring[:-1]]


def box(west: float, east: float, *holes: Any) -> list[Any]:
    return [[[west, SOUTH], [east, SOUTH], [east, NORTH], [west, NORTH], [west, SOUTH]], *holes]


def words(ring: list[list[float]]) -> str:
    return " ".join(f"{longitude},{latitude}" for longitude, latitude in ring)


LINES = "\n".join(f"{latitude},{longitude}" for latitude, longitude in swapped(RING))
HOLE_LINES = "\n".join(f"{latitude},{longitude}" for latitude, longitude in swapped(HOLE))
BOUNDARY = "<{0}BoundaryIs><LinearRing><coordinates>{1}</coordinates></LinearRing></{0}BoundaryIs>"
KML = f"<Polygon>{BOUNDARY.format('outer', words(RING))}{BOUNDARY.format('inner', words(HOLE))}</Polygon>"
FENCE = {"version": 2, "circles": [], "polygons": [{"inclusion": False, "polygon": swapped(HOLE)}]}
SURVEY = {"complexItemType": "survey", "polygon": swapped(RING)}
FILES: dict[str, Any] = {
    "wraps.geojson": {"type": "Polygon", "coordinates": [RING, HOLE]},
    "beyond.geojson": {"type": "Polygon", "coordinates": [beyond(RING), beyond(HOLE)]},
    "cut.geojson": {"type": "MultiPolygon", "coordinates": [box(WEST, 180.0, HOLE), box(-180.0, EAST)]},
    "table.csv": f"latitude,longitude\n{LINES}\n\n{HOLE_LINES}\n",
    "google.kml": f"<kml><Placemark>{KML}</Placemark></kml>",
    "survey.plan": {"fileType": "Plan", "mission": {"items": [SURVEY]}, "geoFence": FENCE},
}


def written(folder: Path, name: str) -> Path:
    content = FILES[name]
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize("origin_deg", ORIGINS)
@pytest.mark.parametrize("name", FILES)
def test_a_field_across_the_meridian_of_180_degrees_is_read(
    name: str, origin_deg: tuple[float, float], tmp_path: Path
) -> None:
    area = read_area(written(tmp_path, name), origin_deg)
    assert ring_area(area.polygon_ned_m) == pytest.approx(SIZE_M2, rel=0.02)
    assert [ring_area(hole) for hole in area.holes_ned_m] == [pytest.approx(HOLE_M2, rel=0.02)]


def test_a_shapefile_across_the_meridian_keeps_its_hole(tmp_path: Path) -> None:
    with shapefile.Writer(str(tmp_path / "field")) as writer:
        writer.field("name", "C")
        writer.poly([RING[::-1], HOLE])
        writer.record("field")
    area = read_area(tmp_path / "field.shp", ORIGINS[0])
    assert ring_area(area.polygon_ned_m) == pytest.approx(SIZE_M2, rel=0.02) and len(area.holes_ned_m) == 1


def test_parts_of_a_geojson_that_are_not_cut_at_the_meridian_stay_parts(tmp_path: Path) -> None:
    apart = {"type": "MultiPolygon", "coordinates": [box(WEST, 180.0), box(-179.9999, EAST)]}
    (tmp_path / "field.geojson").write_text(json.dumps(apart))
    assert read_area(tmp_path / "field.geojson", ORIGINS[0], feature=2).name == ""


def test_a_mission_and_a_fence_across_the_meridian_are_read(tmp_path: Path) -> None:
    places = (
        f"points: {{a: {{degrees: [{NORTH}, {EAST}], altitude_m: 3}}}}\nareas: {{f: {{degrees: {swapped(RING)}}}}}\n"
    )
    steps = "steps:\n  - go_to: {target_ned_m: a}\n  - area_coverage: {polygon_ned_m: f, z_ned_m: -5, overlap: 0.7}\n"
    (tmp_path / "mission.yaml").write_text(places + steps)
    go_to, coverage = read_mission(tmp_path / "mission.yaml", (*ORIGINS[0], 0.0)).mission.steps
    assert go_to.goal["target_ned_m"] == pytest.approx([22.2, 21.3, -3.0], abs=0.1)  # type: ignore[union-attr]
    assert ring_area(coverage.goal["polygon_ned_m"]) == pytest.approx(SIZE_M2, rel=0.02)  # type: ignore[union-attr]
    north = [[latitude + 0.0001, longitude] for latitude, longitude in swapped(RING)]
    north[0][1], north[3][1] = 179.9998, 179.9998
    zones = [{"inclusion": True, "polygon": ring} for ring in (swapped(RING), north)]
    plan = {"fileType": "Plan", "geoFence": {"version": 2, "polygons": zones}}
    (tmp_path / "field.plan").write_text(json.dumps(plan))
    fence = read_fence(tmp_path / "field.plan")
    assert fence.keep_in is not None and {abs(round(b)) for _, b in fence.keep_in.corners_deg} == {180}
    assert len(fence.keep_in.corners_deg) > 4
