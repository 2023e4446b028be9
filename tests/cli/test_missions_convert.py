"""`jezero mission import` and `export`: the files that they write, and their sentences."""

import json
from math import cos, sin
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from jezero import Vehicle
from jezero.area_files import read_polygons
from jezero.cli.main import main
from jezero.mission_files import read_fence, read_mission
from jezero.schemas.actions import PlanReply
from tests.client.rig import ODOMETRY, Server, a_status, endpoint, server, vehicle
from tests.mission_files.qgc import (
    FIELD_DEG,
    HOLE_DEG,
    HOME_DEG,
    LAND,
    TAKEOFF,
    WAYPOINT,
    plan,
    simple,
    survey,
    written,
)

__all__ = ["endpoint", "server", "vehicle"]

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
    refused = run("import", file, "-o", out)
    assert refused.exit_code == 1 and not out.exists()
    assert refused.stderr.splitlines() == [
        f"{file} has what no mission can have:", "  item 3 (do jump): no action does it",
        "change the plan, or leave this out with --leave-out",
    ]  # fmt: skip
    done = run("import", file, "-o", out, "--leave-out")
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert lines[0] == "left out: item 3 (do jump): no action does it"
    assert lines[-1] == f"{out}: 5 steps; jezero mission check {out} plans them"
    survey_1 = "polygon_ned_m: survey_1, z_ned_m: -40.0, overlap: 0.75, sidelap: 0.65, angle_rad: 0.0"
    assert f"- area_coverage: {{{survey_1}}}" in out.read_text()
    assert read_mission(out, HOME_DEG[:2]).mission.name == "survey"


def test_the_geofence_of_a_plan_is_written_beside_the_mission_and_none_is_written_over(tmp_path: Path) -> None:
    file = written(tmp_path, plan(TAKEOFF, WAYPOINT, polygons=[(FIELD_DEG, True), (HOLE_DEG, False)]))
    out, beside = tmp_path / "mission.yaml", tmp_path / "mission.fence.yaml"
    done = run("import", file, "-o", out)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines()[-1] == f"{beside}: the geofence; jezero fence set {beside} puts it in force"
    fence = read_fence(beside)
    assert fence.keep_in is not None and [list(corner) for corner in fence.keep_in.corners_deg] == FIELD_DEG
    assert [[list(corner) for corner in zone.corners_deg] for zone in fence.keep_out] == [HOLE_DEG]
    out.write_text("mine")
    beside.unlink()
    again = run("import", file, "-o", out)
    assert again.exit_code == 1 and f"{out} exists: choose another name, or add --force" in again.stderr
    assert out.read_text() == "mine" and not beside.exists(), "nothing is written if one file may not be"
    assert run("import", file, "-o", out, "--force").exit_code == 0
    assert beside.exists() and "takeoff" in out.read_text()


def test_heights_above_sea_level_are_checked_around_the_simulators_origin_or_named(tmp_path: Path) -> None:
    takeoff, high = (
        simple(command, [0, 0, 0, None, 47.39783193, 8.545594, altitude_m], frame=0)
        for command, altitude_m in ((22, 491), (16, 494))
    )
    file, out = written(tmp_path, plan(takeoff, high, home=(47.39783193, 8.545594, 448))), tmp_path / "mission.yaml"
    assert "the planned home position is at 448 m, which is not used" in run("import", file, "-o", out).stdout
    (mission,) = map(json.loads, run("check", out, "--json", *NOBODY).stdout.splitlines())
    first, second = (step["goal"] for step in mission["steps"])
    assert first == {"altitude_m": 3.0} and second["target_ned_m"][2] == -6.0
    elsewhere = run("check", out, "--origin", "47.3978", "8.5456", *NOBODY)
    assert elsewhere.exit_code == 1
    assert "is 491 m above sea level, and the altitude of the world's origin is not known" in elsewhere.stderr


def test_a_geofence_that_is_none_is_refused_unless_it_is_left_out(tmp_path: Path) -> None:
    line = [[47.3980, 8.5458], [47.3981, 8.5459], [47.3982, 8.5460]]
    file, out = written(tmp_path, plan(TAKEOFF, polygons=[(line, True)])), tmp_path / "mission.yaml"
    refused = run("import", file, "-o", out)
    assert refused.exit_code == 1 and "all its corners are in one line" in refused.stderr
    assert run("import", file, "-o", out, "--leave-out").exit_code == 0
    assert not (tmp_path / "mission.fence.yaml").exists()


@pytest.mark.parametrize("command", [["check"], ["export", "-o", "{folder}/out.kml"]])
def test_a_plan_in_place_of_a_mission_is_told_to_import_it_in_one_sentence(command: list[str], tmp_path: Path) -> None:
    words = [word.format(folder=tmp_path) for word in command]
    for name in ("field.plan", "field.waypoints", "field.kml", "field.mission", "field.kmz"):
        file = written(tmp_path, plan(TAKEOFF) | {"version": 42}, name)
        done = run(words[0], file, *words[1:], *NOBODY)
        assert done.exit_code == 1
        made = file.with_suffix(".yaml").name
        assert done.stderr == f"{file} is no mission of jezero yet: jezero mission import {file} -o {made} makes one\n"


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


def test_an_export_writes_over_a_file_with_force_only(tmp_path: Path) -> None:
    out = tmp_path / "flight.plan"
    out.write_text("mine")
    refused = run("export", "flight", "-o", out, *NOBODY)
    assert refused.exit_code == 1 and "exists: choose another name, or add --force" in refused.stderr
    assert out.read_text() == "mine"
    assert run("export", "flight", "-o", out, "--force", *NOBODY).exit_code == 0
    assert json.loads(out.read_text())["fileType"] == "Plan"


def test_heights_above_sea_level_are_counted_from_the_origin_of_the_stack(
    tmp_path: Path, server: Server, vehicle: Vehicle, endpoint: str
) -> None:
    odometry = msgspec.structs.replace(ODOMETRY, origin_deg=(*HOME_DEG[:2], 485.0))
    server.serve("status", msgspec.structs.replace(a_status(), odometry=odometry, armed=False, landed=True))
    server.serve("@action/takeoff/plan", PlanReply(accepted=True, duration_s=4.0))
    takeoff = simple(22, [0, 0, 0, None, *HOME_DEG[:2], 491], frame=0)
    out = tmp_path / "mission.yaml"
    run("import", written(tmp_path, plan(takeoff, home=(*HOME_DEG[:2], 0))), "-o", out)
    done = run("check", out, "--json", "--vehicle", "v", "--router", endpoint)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["steps"][0]["goal"] == {"altitude_m": 6.0}


def test_each_line_of_json_has_a_note_or_the_file(tmp_path: Path) -> None:
    out = tmp_path / "flight.plan"
    done = run("export", "flight", "-o", out, "--json", *NOBODY)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["type"] for row in rows] == ["lost", "written"]
    assert "a plan can't land on the rover" in rows[0]["note"]
    assert rows[1]["file"] == str(out)


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        ("import nothing.plan -o a.yaml", "does not exist", 2),
        ("import {file}", "Missing option '-o'", 2),
        ("import {csv} -o a.yaml", "its name must end in one of .plan, .mission", 2),
        ("import {empty} -o {folder}/a.yaml", "has nothing to fly", 1),
        ("import {text} -o {folder}/a.yaml", "text.plan", 1),
        ("import {file} -o {folder}/none/a.yaml", "can't be written: No such file or directory", 1),
        ("export flight -o a.pdf", "its name must end in .plan, .kml or .kmz", 2),
        ("export nothing -o {folder}/a.plan", "there is no mission 'nothing'; known are demonstration", 1),
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


def test_a_geofence_with_too_many_corners_is_written_and_named(tmp_path: Path) -> None:
    ring = [[47.3980 + 0.001 * cos(0.01 * step), 8.5458 + 0.001 * sin(0.01 * step)] for step in range(600)]
    done = run("import", written(tmp_path, plan(TAKEOFF, polygons=[(ring, True)])), "-o", tmp_path / "mission.yaml")
    assert done.exit_code == 1 and f"{tmp_path / 'mission.fence.yaml'}, line 3: " in done.stderr


def test_a_plan_with_numbers_that_no_goal_takes_is_written_and_its_lines_are_named(tmp_path: Path) -> None:
    out = tmp_path / "mission.yaml"
    done = run("import", written(tmp_path, plan(TAKEOFF, simple(93, [99999, 0, 0, 0, 0, 0, 0], 2))), "-o", out)
    assert done.exit_code == 1
    assert f"{out}, line 4: wait needs seconds, 0 to 3600" in done.stderr
    assert out.exists()
