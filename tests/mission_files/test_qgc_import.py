"""Plans of QGroundControl as missions: what becomes what, and the sentence for each part that is lost."""

from collections.abc import Iterator
from contextlib import suppress
from math import radians
from pathlib import Path
from typing import Any

import pytest

from jezero.area_files import AreaFileError
from jezero.mission_files import MissionFileError, read_mission
from jezero.mission_files.imported import ImportedMission
from jezero.mission_files.qgc_import import import_plan
from jezero.schemas.mission import GoalStep, Step, WaitStep
from tests.mission_files.qgc import FIELD_DEG, HOLE_DEG, HOME_DEG, LAND, TAKEOFF, WAYPOINT, plan, simple, survey


def steps_of(made: ImportedMission, folder: Path) -> tuple[Step, ...]:
    """The steps that the imported mission's file has around the plan's home."""
    path = folder / "mission.yaml"
    path.write_text(made.to_yaml())
    return read_mission(path, HOME_DEG[:2]).mission.steps


def goals_of(made: ImportedMission, folder: Path) -> list[tuple[str, dict[str, Any]]]:
    return [(step.action, step.goal) for step in steps_of(made, folder) if isinstance(step, GoalStep)]


def test_takeoff_waypoint_hold_survey_and_landing_become_steps(tmp_path: Path) -> None:
    made = import_plan(plan(TAKEOFF, WAYPOINT, survey(), LAND), "field")
    steps = steps_of(made, tmp_path)
    assert [step.action if isinstance(step, GoalStep) else "wait" for step in steps] == [
        "takeoff", "go_to", "wait", "area_coverage", "land_on_spot",
    ]  # fmt: skip
    assert isinstance(steps[2], WaitStep) and steps[2].duration_s == 4.0
    (_, takeoff), (_, go_to), (_, coverage), (_, landing) = goals_of(made, tmp_path)
    assert takeoff == {"altitude_m": 15.0}
    assert go_to["target_ned_m"] == pytest.approx([28.69, 30.56, -25.0], abs=0.05)
    assert go_to["yaw_rad"] == pytest.approx(radians(90.0), abs=1e-5)
    assert (coverage["z_ned_m"], coverage["overlap"], coverage["sidelap"]) == (-40.0, 0.75, 0.65)
    assert len(coverage["polygon_ned_m"]) == 4
    assert (landing["use_uwb"], landing["use_tag"]) == (False, False)
    assert landing["landing_spot_ned_m"] == pytest.approx([6.45, 7.98, 0.0], abs=0.05)
    assert made.notes == ["item 3 (survey): its overlaps hold for the vehicle's own camera, and not for Sony ILCE-QX1"]


def test_the_places_follow_the_vehicles_origin(tmp_path: Path) -> None:
    path = tmp_path / "mission.yaml"
    path.write_text(import_plan(plan(TAKEOFF, WAYPOINT), "field").to_yaml())
    further_south = read_mission(path, (HOME_DEG[0] - 0.0001, HOME_DEG[1])).mission.steps[1]
    assert isinstance(further_south, GoalStep)
    assert further_south.goal["target_ned_m"] == pytest.approx([28.69 + 11.12, 30.56, -25.0], abs=0.05)


def test_altitudes_above_sea_level_are_counted_from_the_planned_home(tmp_path: Path) -> None:
    high = simple(16, [0, 0, 0, None, 47.3980, 8.5460, 518.0], frame=0)
    absolute = survey(camera={"DistanceMode": 2, "DistanceToSurface": 528})
    goals = goals_of(import_plan(plan(TAKEOFF, high, absolute), "field"), tmp_path)
    assert goals[1][1]["target_ned_m"][2] == -30.0
    assert goals[2][1]["z_ned_m"] == -40.0
    with pytest.raises(AreaFileError, match="item 1 is at 518 m above sea level, and the plan has no planned home"):
        import_plan(plan(high, home=()), "field")


def test_a_change_of_speed_holds_for_the_steps_after_it(tmp_path: Path) -> None:
    faster, default = simple(178, [1, 3, -1, 0, 0, 0, 0], 2), simple(178, [1, -2, -1, 0, 0, 0, 0], 2)
    made = import_plan(plan(TAKEOFF, WAYPOINT, faster, WAYPOINT, survey(), default, WAYPOINT), "field")
    speeds = [goal.get("speed_mps") for action, goal in goals_of(made, tmp_path) if action != "takeoff"]
    assert speeds == [None, 3.0, 3.0, None]


def test_an_exclusion_zone_in_a_survey_is_a_hole_and_rally_points_are_points(tmp_path: Path) -> None:
    content = plan(TAKEOFF, survey(), polygons=[(HOLE_DEG, False)], rally=[[47.3979, 8.5457, 12]])
    made = import_plan(content, "field")
    assert made.areas == {"survey_1": {"degrees": FIELD_DEG, "holes": [HOLE_DEG]}}
    assert made.points["rally_1"] == {"degrees": [47.3979, 8.5457], "altitude_m": 12.0}
    assert len(goals_of(made, tmp_path)[1][1]["holes_ned_m"][0]) == 3
    assert made.notes[-2].startswith("1 rally point of the plan: points of the mission, which no step uses")
    assert made.notes[-1].startswith("the geofence (1 zone) is not part of a mission")


def test_a_survey_without_a_known_camera_keeps_the_distance_of_its_lines(tmp_path: Path) -> None:
    manual = {
        "CameraName": "Manual (no camera specs)", "AdjustedFootprintSide": 6, "AdjustedFootprintFrontal": 4,
    }  # fmt: skip
    made = import_plan(plan(TAKEOFF, survey(camera=manual)), "field")
    goal = goals_of(made, tmp_path)[1][1]
    assert goal["resolution_m"] == 6.0 and "overlap" not in goal
    assert made.notes == ["item 2 (survey): images are 6 m apart as the lines are, and not 4 m"]


def test_a_takeoff_elsewhere_a_return_and_a_landing_here(tmp_path: Path) -> None:
    aside = simple(22, [0, 0, 0, None, 47.3979, 8.545594, 15])
    here, back = simple(21, [0, 0, 0, None, 0, 0, 0]), simple(20, [0, 0, 0, 0, 0, 0, 0], 2)
    made = import_plan(plan(aside, here, TAKEOFF, back), "field")
    goals = goals_of(made, tmp_path)
    assert [action for action, _ in goals] == ["takeoff", "go_to", "land_on_spot", "takeoff", "return_home"]
    assert goals[1][1]["target_ned_m"] == goals[2][1]["landing_spot_ned_m"]
    assert made.notes == ["item 4 (return) goes to the rover if its position is known, else to the take-off point"]


@pytest.mark.parametrize(
    ("item", "note"),
    [
        (simple(177, [1, 2, 0, 0, 0, 0, 0], 2), "item 2 (do jump) is left out: no action does it"),
        (simple(206, [5, 0, 1, 0, 0, 0, 0], 2), "item 2 (camera trigger distance) is left out"),
        (simple(4711, [0] * 7), "item 2 (MAVLink command 4711) is left out"),
        (simple(18, [3, 0, 20, 0, 47.3980, 8.5460, 25]), "item 2 (loiter turns) is left out"),
        (simple(17, [0, 0, 0, 0, 47.3980, 8.5460, 25]), "item 2 (loiter unlimited) is a waypoint"),
        (simple(16, [0, 0, 0, 0, 0, 0, 25]), "item 2 is left out: it has no latitude and longitude"),
        (
            simple(16, [0, 0, 0, 0, 47.398, 8.546, 25], 10),
            "item 2: its 25 m over the terrain are flown over the take-off",
        ),
        (simple(21, [0] * 7), "item 2 (land) is left out: it has no latitude and longitude, and nothing was flown"),
        (simple(93, [-1, 12, 0, 0, 0, 0, 0], 2), "item 2 (delay until a time of day) is left out"),
        ({"type": "ComplexItem", "complexItemType": "CorridorScan"}, "item 2 (CorridorScan) is left out: only surveys"),
        (
            survey(angle=45, style={"TurnAroundDistance": 10, "Refly90Degrees": True}),
            "item 2 (survey): the coverage plans its own lines, without their direction of 45°, the turnarounds of "
            "10 m, the second pass across",
        ),
        (survey(camera={"FrontalOverlap": 98}), "item 2 (survey): overlaps above 95 % become 95 %"),
    ],
)
def test_what_a_mission_can_not_have_is_named(item: dict[str, Any], note: str) -> None:
    assert any(found.startswith(note) for found in import_plan(plan(TAKEOFF, item), "field").notes)


def test_a_plan_without_a_takeoff_says_that_it_begins_in_the_air() -> None:
    assert import_plan(plan(WAYPOINT), "field").notes == [
        "the plan has no takeoff at its begin: fly it from a hover, or add the step takeoff"
    ]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"fileType": "Mission"}, 'is not a plan of QGroundControl: it has no "fileType": "Plan"'),
        (plan(), "has nothing to fly: no takeoff, waypoint, survey or landing"),
        (plan(simple(22, [0, 0, 0, None, 47.0, 8.0, None])), "item 1 has no altitude"),
        (plan(survey(camera={"DistanceToSurface": None})), r"item 1 \(survey\) has no altitude"),
        (plan(survey(polygon=[[1, 2]])), "survey 1 has 1 corner, and an area needs three"),
        (plan(simple(16, [0, 0, 0, None, 147.0, 8.0, 5])), "147, 8 is no latitude and longitude"),
        (plan(TAKEOFF, rally=["here"]), 'rally point 1: "here" is not'),
        ({"fileType": "Plan", "mission": {"items": [3]}}, 'item 1: "3" is no item of a mission'),
    ],
)
def test_what_is_no_plan_is_refused_with_its_place(content: Any, why: str) -> None:
    with pytest.raises(AreaFileError, match=why):
        import_plan(content, "field")


JUNK: tuple[Any, ...] = (None, True, -1, 1e308, "x", "", [], [[]], {}, {"x": 1}, float("inf"))


def mutations(value: Any) -> Iterator[Any]:
    """Copies of a value of JSON with one part replaced by junk."""
    yield from JUNK
    if isinstance(value, dict):
        for key, part in value.items():
            yield from (value | {key: changed} for changed in mutations(part))
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from ([*value[:index], changed, *value[index + 1 :]] for changed in mutations(part))


def test_no_plan_with_junk_in_it_breaks_the_import(tmp_path: Path) -> None:
    whole = plan(TAKEOFF, WAYPOINT, survey(), LAND, polygons=[(HOLE_DEG, False)], rally=[[47.3979, 8.5457, 12]])
    made = 0
    for content in mutations(whole):
        try:
            text = import_plan(content, "field").to_yaml()
        except AreaFileError as error:
            assert str(error)
            continue
        if made % 20 == 0:  # reading takes longer than making
            (tmp_path / "mission.yaml").write_text(text)
            with suppress(MissionFileError):
                read_mission(tmp_path / "mission.yaml", HOME_DEG[:2])
        made += 1
    assert made > 500
