"""A file that nests 20,000 brackets ends soon with a sentence, in every format of missions, fences and areas."""

import gc
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from jezero.area_files import AreaFileError, read_polygons
from jezero.mission_files import MissionFileError, read_fence, read_mission

DEPTH = 20_000
OPEN, CLOSED = "[" * DEPTH, "]" * DEPTH
LATEST_S = 1.0
"""Longest processor time of this thread; wall time is longer on a busy machine, and other threads have their own."""
YAML = {
    "list.yaml": f"steps: {OPEN}{CLOSED}\n",
    "open.yaml": f"steps: {OPEN}\n",
    "fields.yaml": f"steps: {'{a: ' * DEPTH}{'}' * DEPTH}\n",
    "dashes.yaml": f"steps:\n{'- ' * DEPTH}x\n",
    "keys.yaml": f"{'? ' * DEPTH}x\n",
    "indented.yaml": "".join(f"{' ' * level}a:\n" for level in range(1_200)),
    "tagged.yaml": f"steps: {'!!seq [' * DEPTH}{CLOSED}\n",
    "list.json": f'{{"steps": {OPEN}{CLOSED}}}',
    "open.json": f'{{"steps": {OPEN}',
    "fields.json": '{"steps": ' + '{"a":' * DEPTH + "1" + "}" * (DEPTH + 1),
}
TRIANGLE = '{"type":"Polygon","coordinates":[[[0,0],[0,1],[1,1],[0,0]]]}'
BOUNDARY = "<outerBoundaryIs><LinearRing><coordinates>0,0 0,1 1,1 0,0</coordinates></LinearRing></outerBoundaryIs>"
KML = f"<kml>{'<Placemark>' * DEPTH}<Polygon>{BOUNDARY}</Polygon>{'</Placemark>' * DEPTH}</kml>"
AREAS = {
    "list.geojson": OPEN + CLOSED,
    "open.json": OPEN,
    "coordinates.geojson": f'{{"type":"Polygon","coordinates":{OPEN}{CLOSED}}}',
    "features.geojson": '{"type":"Feature","geometry":' * DEPTH + "null" + "}" * DEPTH,
    "collections.json": '{"type":"GeometryCollection","geometries":[' * DEPTH + "]}" * DEPTH,
    "properties.geojson": f'{{"type":"Feature","properties":{{"name":{OPEN}{CLOSED}}},"geometry":{TRIANGLE}}}',
    "survey.plan": f'{{"fileType":"Plan","mission":{{"items":{OPEN}{CLOSED}}}}}',
    "folders.kml": f"<kml>{'<Folder>' * DEPTH}{'</Folder>' * DEPTH}</kml>",
    "placemarks.kml": KML,
    "open.kml": "<Folder>" * DEPTH,
    "corners.csv": f"lat,lon\n{OPEN}{CLOSED}\n",
}


def refusal(read: str, file: Path) -> str:
    """The error of a reader, which it gives within `LATEST_S`."""
    readers: dict[str, Callable[[Path], object]] = {"mission": read_mission, "fence": read_fence, "area": read_polygons}
    gc.disable()  # what tests before have left would be collected in this time
    began_s = time.thread_time()
    try:
        with pytest.raises((MissionFileError, AreaFileError)) as caught:
            readers[read](file)
        assert time.thread_time() - began_s < LATEST_S
    finally:
        gc.enable()
    return str(caught.value)


@pytest.mark.parametrize("name", YAML)
@pytest.mark.parametrize("read", ["mission", "fence"])
def test_a_mission_and_a_fence_of_brackets_end_with_a_sentence(read: str, name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text(YAML[name])
    assert f"{name}, line " in refusal(read, file)
    assert "are nested more than 50 deep here: nobody needs more than ten" in refusal(read, file)


@pytest.mark.parametrize("depth", [50, 400, 900, DEPTH])
def test_a_plan_of_brackets_has_no_geofence_or_is_nested_too_deeply(depth: int, tmp_path: Path) -> None:
    file = tmp_path / "deep.plan"
    file.write_text(f'{{"fileType":"Plan","geoFence":{{"polygons":{"[" * depth}{"]" * depth}}}}}')
    assert "is nested too deeply" in refusal("fence", file) or "is not a fence" in refusal("fence", file)


@pytest.mark.parametrize("name", AREAS)
def test_an_area_of_brackets_ends_with_a_sentence(name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text(AREAS[name])
    assert name in refusal("area", file)


def test_an_archive_and_a_shapefile_of_brackets_end_with_a_sentence(tmp_path: Path) -> None:
    archive, shape = tmp_path / "deep.kmz", tmp_path / "deep.shp"
    with zipfile.ZipFile(archive, "w") as opened:
        opened.writestr("doc.kml", KML)
    shape.write_bytes(bytes(100))
    shape.with_suffix(".prj").write_text(f"{'GEOGCS[' * DEPTH}{CLOSED}")
    assert "is nested too deeply" in refusal("area", archive)
    assert "is not known" in refusal("area", shape)


def test_an_area_that_a_mission_names_is_read_in_the_same_way(tmp_path: Path) -> None:
    (tmp_path / "deep.geojson").write_text(AREAS["coordinates.geojson"])
    file = tmp_path / "mission.yaml"
    file.write_text("areas: {field: deep.geojson}\nsteps:\n- takeoff: {altitude_m: 3}\n")
    assert "is nested too deeply" in refusal("mission", file)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("mission", "check"), "list.yaml"),
        (("mission", "check"), "fields.json"),
        (("fence", "check"), "open.json"),
        (("mission", "import", "-o", "out.yaml"), "survey.plan"),
        (("mission", "import", "-o", "out.yaml"), "placemarks.kml"),
    ],
)
def test_the_commands_print_one_sentence_and_no_traceback(words: tuple[str, ...], name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text({**AREAS, **YAML}[name])
    done = subprocess.run(
        [sys.executable, "-m", "jezero.cli.main", *words, name],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert "nested" in done.stderr + done.stdout and "Traceback" not in done.stderr, done.stderr
