"""Missions as plans of QGroundControl, and back again."""

from pathlib import Path
from typing import Any

import pytest

from jezero.area_files.qgc_plan import read_plan
from jezero.mission_files import read_mission, shipped_mission
from jezero.mission_files.qgc_export import ExportError, export_plan
from jezero.mission_files.qgc_import import import_plan
from jezero.schemas.mission import GoalStep, Mission, WaitStep
from jezero.services.actions.config import ActionsConfig
from tests.mission_files.qgc import HOME_DEG

GOOD = """\
mission: round
areas:
  square: {degrees: [[47.3980, 8.5458], [47.3980, 8.5460], [47.3982, 8.5460], [47.3982, 8.5458]]}
  rows: [[0, 0], [0, 20], [20, 20], [20, 0]]
steps:
  - takeoff: {altitude_m: 10}
  - go_to: {target_ned_m: [20, 10, -12], speed_mps: 3, yaw_rad: 1.5}
  - wait: 5
  - area_coverage: {polygon_ned_m: square, z_ned_m: -15, overlap: 0.7, sidelap: 0.6}
  - area_coverage: {polygon_ned_m: rows, z_ned_m: -8, resolution_m: 4, speed_mps: 2}
  - land_on_spot: {landing_spot_ned_m: [1, 2, 0], use_uwb: false, use_tag: false}
"""


def mission_of(text: str, folder: Path) -> Mission:
    path = folder / "mission.yaml"
    path.write_text(text)
    return read_mission(path, HOME_DEG[:2]).mission


def exported(mission: Mission) -> tuple[dict[str, Any], list[str]]:
    return export_plan(mission, HOME_DEG, ActionsConfig())


def same(there: Any, back: Any) -> bool:
    """Whether two values of goals are the same to two centimetres."""
    if isinstance(there, list | tuple):
        return len(there) == len(back) and all(map(same, there, back))
    return bool(there == back or there == pytest.approx(back, abs=0.02))


def test_a_mission_comes_back_from_its_plan(tmp_path: Path) -> None:
    mission = mission_of(GOOD, tmp_path)
    plan, notes = exported(mission)
    assert notes == []
    back = mission_of(import_plan(plan, "round").to_yaml(), tmp_path)
    assert len(back.steps) == len(mission.steps)
    for step, again in zip(mission.steps, back.steps, strict=True):
        if isinstance(step, WaitStep):
            assert step == again
            continue
        assert isinstance(again, GoalStep) and again.action == step.action
        for name, value in step.goal.items():
            if name not in ("origin_deg", "speed_mps"):
                assert same(value, again.goal.get(name, ())), (step.action, name)
    speeds = [step.goal.get("speed_mps") for step in back.steps if isinstance(step, GoalStep)]
    assert speeds == [None, 3.0, None, 2.0, None]


def test_a_survey_has_the_lines_of_the_coverages_own_plan(tmp_path: Path) -> None:
    plan, _ = exported(mission_of(GOOD, tmp_path))
    surveys = [item for item in plan["mission"]["items"] if item["type"] == "ComplexItem"]
    by_overlap, by_distance = (survey["TransectStyleComplexItem"] for survey in surveys)
    assert by_overlap["CameraCalc"]["CameraName"] == "Custom Camera"
    assert (by_overlap["CameraCalc"]["FrontalOverlap"], by_overlap["CameraCalc"]["SideOverlap"]) == (70.0, 60.0)
    assert by_distance["CameraCalc"]["CameraName"] == "Manual (no camera specs)"
    assert by_distance["CameraCalc"]["AdjustedFootprintSide"] == 4.0
    commands = [item["command"] for item in by_distance["Items"]]
    assert commands[:2] == [16, 206] and commands[-1] == 206 and commands.count(16) > 6
    assert len(by_distance["VisualTransectPoints"]) == commands.count(16)
    assert len(read_plan(plan)) == 2, "jezero gridsweep reads the areas, too"


def test_the_numbers_of_the_items_are_each_used_once(tmp_path: Path) -> None:
    plan, _ = exported(mission_of(GOOD, tmp_path))
    numbers = []
    for item in plan["mission"]["items"]:
        inside = item["TransectStyleComplexItem"]["Items"] if item["type"] == "ComplexItem" else [item]
        numbers += [each["doJumpId"] for each in inside]
    assert numbers == list(range(1, len(numbers) + 1))


def test_images_around_a_target_are_waypoints_with_the_camera_at_it(tmp_path: Path) -> None:
    text = "steps:\n  - get_images: {center_ned_m: [10, 0, -5], radius_m: 3, num_images: 4}\n"
    plan, notes = exported(mission_of(text, tmp_path))
    commands = [item["command"] for item in plan["mission"]["items"]]
    assert commands == [195, 16, 2000, 16, 2000, 16, 2000, 16, 2000, 197]
    assert notes == ["step 1 (get images (10, 0, -5)) is 4 waypoints with straight lines between them, not a circle"]


def test_holes_are_exclusion_zones_and_come_back_as_holes(tmp_path: Path) -> None:
    text = (
        "areas:\n  ring: {degrees: [[47.3980, 8.5458], [47.3980, 8.5464], [47.3984, 8.5464], [47.3984, 8.5458]],\n"
        "    holes: [[[47.3981, 8.5460], [47.3981, 8.5462], [47.3983, 8.5462]]]}\n"
        "steps:\n  - area_coverage: {polygon_ned_m: ring, z_ned_m: -10, overlap: 0.5, margin_outline_m: 1}\n"
    )
    plan, notes = exported(mission_of(text, tmp_path))
    assert len(plan["geoFence"]["polygons"]) == 1
    assert len(import_plan(plan, "ring").areas["survey_1"]["holes"]) == 1
    assert "holes of the area are exclusion zones of the geofence" in notes[0]
    assert "QGroundControl has no margin, so that 1 m are lost" in notes[1]


def test_what_a_plan_can_not_have_is_named(tmp_path: Path) -> None:
    _, notes = exported(shipped_mission("patrol"))
    assert notes == [
        "step 18 (land on spot) is left out: a plan can't land on the rover, and ends in the air",
        "on_failure is left out: the autopilot's own failsafes apply",
    ]
    _, notes = exported(shipped_mission("demonstration"))
    assert notes[0] == "step 3 (get images (0, 0, -3)) is left out: a plan has no points relative to the rover"
    _, notes = exported(mission_of("steps:\n  - takeoff\n  - return_home\n", tmp_path))
    assert notes == ["step 2 (return home) is the autopilot's own return: to the take-off point, and not to the rover"]


def test_a_mission_with_nothing_for_a_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="has no step that a plan of QGroundControl can have: step 1"):
        exported(mission_of("steps:\n  - land_on_spot\n", tmp_path))


def test_rally_points_come_back_from_a_plan(tmp_path: Path) -> None:
    plan, _ = exported(mission_of(GOOD + "rally_points: [[20, -15], [3, 4]]\n", tmp_path))
    back = mission_of(import_plan(plan, "round").to_yaml(), tmp_path)
    assert [pytest.approx(point, abs=0.02) for point in back.rally_points_ned_m] == [(20.0, -15.0), (3.0, 4.0)]
