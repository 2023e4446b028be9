"""`jezero mission import` and `export`: the files that they write, and their sentences."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.area_files import read_polygons
from jezero.cli.main import main
from jezero.mission_files import read_mission
from tests.mission_files.qgc import FIELD_DEG, HOME_DEG, LAND, TAKEOFF, WAYPOINT, plan, simple, survey, written

NOBODY = ["--router", "tcp/127.0.0.1:9"]
KML = """<kml xmlns="http://www.opengis.net/kml/2.2"><Document>
<Placemark><name>North field</name><Polygon><outerBoundaryIs><LinearRing><coordinates>
8.5458,47.3980 8.5464,47.3980 8.5464,47.3984 8.5458,47.3980</coordinates>
</LinearRing></outerBoundaryIs></Polygon></Placemark>
<Placemark><name>Pond</name><Polygon><outerBoundaryIs><LinearRing><coordinates>
8.5450,47.3980 8.5456,47.3980 8.5456,47.3984 8.5450,47.3980</coordinates>
</LinearRing></outerBoundaryIs></Polygon></Placemark>
</Document></kml>"""


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["mission", *map(str, words)])


def test_a_plan_is_written_as_a_mission_with_a_line_for_what_is_lost(tmp_path: Path) -> None:
    file = written(tmp_path, plan(TAKEOFF, WAYPOINT, simple(177, [1, 2, 0, 0, 0, 0, 0], 2), survey(), LAND))
    out = tmp_path / "mission.yaml"
    done = run("import", file, "-o", out)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert lines[0] == "item 3 (do jump) is left out: no action does it"
    assert lines[-1] == f"{out}: 5 steps; jezero mission check {out} plans them"
    assert "- area_coverage: {polygon_ned_m: survey_1, z_ned_m: -40.0, overlap: 0.75, sidelap: 0.65}" in out.read_text()
    assert read_mission(out, HOME_DEG[:2]).mission.name == "survey"


def test_the_polygons_of_a_kml_file_are_coverages(tmp_path: Path) -> None:
    (tmp_path / "fields.kml").write_text(KML)
    out = tmp_path / "mission.yaml"
    done = run("import", tmp_path / "fields.kml", "-o", out, "--altitude", "6", "--overlap", "0.6")
    assert done.exit_code == 0, done.output
    steps = read_mission(out, HOME_DEG[:2]).mission.steps
    assert [step.label for step in steps] == [
        "takeoff", "area coverage (North-field)", "area coverage (Pond)", "land on spot",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["out.kml", "out.kmz"])
def test_the_areas_of_a_mission_are_written_as_kml(tmp_path: Path, name: str) -> None:
    mission, out = tmp_path / "mission.yaml", tmp_path / name
    run("import", written(tmp_path, plan(TAKEOFF, survey())), "-o", mission)
    done = run("export", mission, "-o", out, *NOBODY)
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("1 other step is left out: only areas are written")
    corners = read_polygons(out)[0].rings[0]
    assert [pytest.approx(corner, abs=1e-7) for corner in corners] == [tuple(corner) for corner in FIELD_DEG]


def test_a_mission_is_written_as_a_plan_around_an_origin(tmp_path: Path) -> None:
    out = tmp_path / "flight.plan"
    done = run("export", "flight", "-o", out, "--origin", "18.4446", "77.4509", *NOBODY)
    assert done.exit_code == 0, done.output
    assert "a plan can't land on the rover" in done.stdout
    assert f"{out}: around the world's origin at 18.444600, 77.450900" in done.stdout
    items = json.loads(out.read_text())["mission"]["items"]
    assert [item["command"] for item in items] == [22, 93, 16, 93, 16]


def test_each_line_of_json_has_a_note_or_the_file(tmp_path: Path) -> None:
    out = tmp_path / "flight.plan"
    done = run("export", "flight", "-o", out, "--json", *NOBODY)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["type"] for row in rows] == ["lost", "written"]
    assert rows[1]["file"] == str(out)


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        ("import nothing.plan -o a.yaml", "does not exist", 2),
        ("import {file}", "Missing option '-o'", 2),
        ("import {csv} -o a.yaml", "its name must end in .plan, .kml or .kmz", 2),
        ("import {empty} -o {folder}/a.yaml", "has nothing to fly", 1),
        ("import {text} -o {folder}/a.yaml", "text.plan", 1),
        ("import {file} -o {folder}/none/a.yaml", "can't be written: No such file or directory", 1),
        ("export flight -o a.pdf", "its name must end in .plan, .kml or .kmz", 2),
        ("export nothing -o {folder}/a.plan", "nothing can't be read", 1),
        ("export flight -o {folder}/a.kml", "has no area: no step covers one in the world frame", 1),
    ],
)
def test_what_can_not_be_converted_is_told_in_a_sentence(words: str, said: str, code: int, tmp_path: Path) -> None:
    (tmp_path / "field.csv").write_text("north,east\n")
    (tmp_path / "text.plan").write_text("no json")
    places = {
        "file": written(tmp_path, plan(TAKEOFF)), "empty": written(tmp_path, plan(), "empty.plan"),
        "csv": tmp_path / "field.csv", "text": tmp_path / "text.plan", "folder": tmp_path,
    }  # fmt: skip
    done = run(*words.format(**places).split(), *(NOBODY if words.startswith("export") else []))
    assert done.exit_code == code, done.output
    assert said in done.output


def test_a_plan_with_numbers_that_no_goal_takes_is_written_and_its_lines_are_named(tmp_path: Path) -> None:
    out = tmp_path / "mission.yaml"
    done = run("import", written(tmp_path, plan(TAKEOFF, simple(93, [99999, 0, 0, 0, 0, 0, 0], 2))), "-o", out)
    assert done.exit_code == 1
    assert f"{out}, line 4: wait needs seconds, 0 to 3600" in done.stderr
    assert out.exists()
