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
    return read_mission(path, HOME_DEG).mission.steps


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


@pytest.mark.parametrize("home", [HOME_DEG, (47.397742, 8.545594, 448.0), (47.397742, 8.545594, 0), ()])
def test_heights_above_sea_level_are_counted_from_the_vehicles_origin(home: Any, tmp_path: Path) -> None:
    takeoff = simple(22, [0, 0, 0, None, 47.397742, 8.545594, 491], frame=0)
    high = simple(16, [0, 0, 0, None, 47.3980, 8.5460, 518.0], frame=5)
    absolute = survey(camera={"DistanceMode": 2, "DistanceToSurface": 528})
    older = survey(camera={"DistanceMode": None, "DistanceToSurfaceRelative": False, "DistanceToSurface": 508})
    made = import_plan(plan(takeoff, high, absolute, older, home=home), "field")
    goals = goals_of(made, tmp_path)
    assert goals[0] == ("takeoff", {"altitude_m": 3.0})
    assert goals[-3][1]["target_ned_m"][2] == -30.0
    assert [goal["z_ned_m"] for _, goal in goals[-2:]] == [-40.0, -20.0]
    assert "heights above sea level are counted from the altitude of the vehicle's origin" in made.notes[-1]
    with pytest.raises(MissionFileError, match="above sea level, and the altitude of the world's origin"):
        read_mission(tmp_path / "mission.yaml", HOME_DEG[:2])
    with pytest.raises(MissionFileError, match=r"above sea level is 9\.0 m below the world's origin"):
        read_mission(tmp_path / "mission.yaml", (*HOME_DEG[:2], 500.0))


@pytest.mark.parametrize(
    ("item", "plan_mode", "height"),
    [
        ({"frame": 3, "AltitudeMode": 1}, 2, 20.0),
        ({"frame": 6, "AltitudeMode": 1}, 1, 20.0),
        ({"frame": 0.0, "AltitudeMode": 2.0, "command": 16.0}, 1, {"amsl_m": 20.0}),
        ({"frame": 3, "AltitudeMode": None, "Altitude": None}, 2, 20.0),
        ({"frame": 0, "AltitudeMode": 2}, 1, {"amsl_m": 20.0}),
        ({"frame": 5, "AltitudeMode": 0}, 1, {"amsl_m": 20.0}),
        ({"frame": 0, "AltitudeMode": 3, "Altitude": 5, "AMSLAltAboveTerrain": 20}, 3, {"amsl_m": 20.0}),
        ({"frame": 0, "AltitudeMode": 1}, 1, {"amsl_m": 20.0}),
        ({"frame": 3, "AltitudeMode": 2}, 1, 20.0),
        ({"frame": None, "AltitudeMode": 2}, 1, {"amsl_m": 20.0}),
        ({"frame": 2, "AltitudeMode": None}, 2, {"amsl_m": 20.0}),
        ({"frame": None, "AltitudeMode": None}, None, 20.0),
    ],
)
def test_each_items_frame_and_mode_and_the_plans_mode_are_obeyed(item: Any, plan_mode: Any, height: Any) -> None:
    content = plan(TAKEOFF, simple(16, [0, 0, 0, None, 47.3980, 8.5460, 20]) | item)
    content["mission"]["globalPlanAltitudeMode"] = plan_mode
    made = import_plan(content, "field")
    assert made.points["waypoint_2"]["altitude_m"] == height
    two_meanings = (item["frame"], item["AltitudeMode"]) in ((0, 1), (3, 2))
    assert any("it is flown by its frame" in note for note in made.notes) == two_meanings


@pytest.mark.parametrize(
    ("item", "why"),
    [
        (simple(16, [0, 0, 0, None, 47.3980, 8.5460, 25], 10), "item 2 is at 25 m over the terrain"),
        (simple(16, [0, 0, 0, None, 47.3980, 8.5460, 25], 11), "item 2 is at 25 m over the terrain"),
        (simple(16, [0, 0, 0, None, 47.3980, 8.5460, 25], 3) | {"AltitudeMode": 4}, "item 2 is at 25 m over the terr"),
        (simple(16, [0, 0, 0, None, 47.3980, 8.5460, 25], 0) | {"AltitudeMode": 3}, "item 2 is at 25 m over the terr"),
        (survey(camera={"DistanceMode": 3}), r"item 2 \(survey\) is at 40 m over the terrain"),
        (survey(camera={"DistanceMode": 4}), r"item 2 \(survey\) is at 40 m over the terrain"),
        (survey(style={"FollowTerrain": True}), r"item 2 \(survey\) follows the terrain"),
        (
            simple(16, [0, 0, 0, None, 4.0, 8.0, -25], 1),
            "item 2 is in MAV_FRAME 1, and places are read in frames",
        ),
        (simple(16, [0, 0, 0, None, 4.0, 8.0, 25], 8), "item 2 is in MAV_FRAME 8"),
        (simple(22, [0, 0, 0, None, 0, 0, -25], 1), "item 2 is in MAV_FRAME 1"),
        (simple(21, [0, 0, 0, None, 4.0, 8.0, 25], 7), "item 2 is in MAV_FRAME 7"),
        (
            simple(16, [0, 0, 0, None, 47.3980, 8.5460, 25]) | {"Altitude": 250},
            "item 2 has two altitudes, 250 m",
        ),
    ],
)
def test_heights_and_frames_that_the_vehicle_does_not_know_are_refused_in_words(item: Any, why: str) -> None:
    with pytest.raises(AreaFileError, match=why):
        import_plan(plan(TAKEOFF, item), "field")


def test_a_plan_for_terrain_as_a_whole_is_refused_where_its_items_say_nothing_else() -> None:
    content = plan(TAKEOFF, simple(16, [0, 0, 0, None, 47.3980, 8.5460, 25]) | {"frame": None, "AltitudeMode": None})
    content["mission"]["globalPlanAltitudeMode"] = 4
    with pytest.raises(AreaFileError, match="item 2 is at 25 m over the terrain"):
        import_plan(content, "field")


def test_a_change_of_speed_holds_for_the_steps_after_it(tmp_path: Path) -> None:
    faster, default = simple(178, [1, 3, -1, 0, 0, 0, 0], 2), simple(178, [1, -2, -1, 0, 0, 0, 0], 2)
    made = import_plan(plan(TAKEOFF, WAYPOINT, faster, WAYPOINT, survey(), default, WAYPOINT), "field")
    speeds = [goal.get("speed_mps") for action, goal in goals_of(made, tmp_path) if action != "takeoff"]
    assert speeds == [None, 3.0, 3.0, None]


def test_an_exclusion_zone_in_a_survey_is_a_hole_and_part_of_the_fence() -> None:
    made = import_plan(plan(TAKEOFF, survey(), polygons=[(HOLE_DEG, False), (FIELD_DEG, True)]), "field")
    assert made.areas == {"survey_1": {"degrees": FIELD_DEG, "holes": [HOLE_DEG]}}
    assert made.fence is not None and made.fence.keep_in is not None
    assert [list(corner) for corner in made.fence.keep_in.corners_deg] == FIELD_DEG
    assert [len(zone.corners_deg) for zone in made.fence.keep_out] == [3]


def test_what_a_geofence_has_besides_its_zones_is_named() -> None:
    content = plan(TAKEOFF, polygons=[(FIELD_DEG, True)])
    content["geoFence"]["breachReturn"] = [47.3981, 8.5460, 20]
    assert import_plan(content, "field").lost == ["the geofence: its point to return to, which no fence of jezero has"]
    circle = {"radius": 50, "center": [47.3981, 8.5460]}
    content["geoFence"] = {"version": 1, "polygon": FIELD_DEG, "circle": circle}
    made = import_plan(content, "field")
    assert made.fence is not None and len(made.fence.zones) == 1 and made.lost == []
    assert made.notes == ["the geofence's circle was a setting of the vehicle, and is no part of the fence"]


def test_rally_points_of_both_versions_are_places_of_the_mission(tmp_path: Path) -> None:
    for version in (1, 2):
        content = plan(TAKEOFF, WAYPOINT, rally=[[47.3979, 8.5457, 12], [47.3980, 8.5457]])
        content["rallyPoints"]["version"] = version
        made = import_plan(content, "field")
        assert made.points["rally_1"] == {"degrees": [47.3979, 8.5457], "altitude_m": 0.0}
        assert made.rally_points == ["rally_1", "rally_2"]
    content["rallyPoints"]["version"] = 3
    with pytest.raises(AreaFileError, match='has rally points of version "3"'):
        import_plan(content, "field")


def test_a_survey_without_a_known_camera_keeps_the_distances_of_its_lines_and_images(tmp_path: Path) -> None:
    manual = {
        "CameraName": "Manual (no camera specs)", "AdjustedFootprintSide": 6, "AdjustedFootprintFrontal": 4,
    }  # fmt: skip
    made = import_plan(plan(TAKEOFF, survey(camera=manual)), "field")
    goal = goals_of(made, tmp_path)[1][1]
    assert (goal["resolution_m"], goal["picture_distance_m"]) == (6.0, 4.0) and "overlap" not in goal
    assert made.notes == []
    none = import_plan(plan(TAKEOFF, survey(camera=manual | {"AdjustedFootprintFrontal": 0})), "field")
    assert "picture_distance_m" not in goals_of(none, tmp_path)[1][1]
    assert none.notes == ["item 2 (survey) takes no images in the plan; the coverage takes one every 6 m"]


@pytest.mark.parametrize(
    ("angle_deg", "lines_rad"), [(0, 0.0), (30, 0.523599), (90, 1.570796), (180, 0.0), (-45, 2.356194), (350, 2.96706)]
)
def test_a_surveys_angle_is_the_direction_of_the_lines(angle_deg: float, lines_rad: float, tmp_path: Path) -> None:
    goals = goals_of(import_plan(plan(TAKEOFF, survey(angle=angle_deg)), "field"), tmp_path)
    assert [goal["angle_rad"] for _, goal in goals[1:]] == [lines_rad]


def test_a_survey_with_a_second_pass_across_is_two_coverages_at_right_angles(tmp_path: Path) -> None:
    made = import_plan(plan(TAKEOFF, survey(angle=30, style={"Refly90Degrees": True})), "field")
    goals = [goal for _, goal in goals_of(made, tmp_path)[1:]]
    assert [goal["angle_rad"] for goal in goals] == [0.523599, 2.094395]
    assert goals[0]["polygon_ned_m"] == goals[1]["polygon_ned_m"] and made.lost == []


def test_a_takeoff_elsewhere_a_return_and_a_landing_here(tmp_path: Path) -> None:
    aside = simple(22, [0, 0, 0, None, 47.3979, 8.545594, 15])
    here, back = simple(21, [0, 0, 0, None, 0, 0, 0]), simple(20, [0, 0, 0, 0, 0, 0, 0], 2)
    made = import_plan(plan(aside, here, TAKEOFF, back), "field")
    goals = goals_of(made, tmp_path)
    assert [action for action, _ in goals] == ["takeoff", "go_to", "land_on_spot", "takeoff", "return_home"]
    assert goals[1][1]["target_ned_m"] == goals[2][1]["landing_spot_ned_m"]
    assert made.notes == ["item 4 (return) goes to the rover if its position is known, else to the take-off point"]


ITEMS = [
    simple(16, [0, 0, 0, None, 47.39779, 8.5460, 6]), simple(206, [3, 0, 1, 0, 0, 0, 0], 2),
    simple(16, [0, 0, 0, None, 47.39785, 8.5460, 7], 0), simple(206, [0, 0, 0, 0, 0, 0, 0], 2),
]  # fmt: skip


def scan(kind: str = "CorridorScan", distance_m: float = 0.0, items: Any = ITEMS) -> dict[str, Any]:
    style = {"CameraCalc": {"AdjustedFootprintFrontal": distance_m}, "Items": items}
    return {"type": "ComplexItem", "complexItemType": kind, "TransectStyleComplexItem": style}


@pytest.mark.parametrize(
    ("item", "note"),
    [
        (simple(177, [1, 2, 0, 0, 0, 0, 0], 2), "item 2 (do jump): no action does it"),
        (simple(206, [5, 0, 1, 0, 0, 0, 0], 2), "item 2 (camera trigger distance): no action does it"),
        (simple(4711, [0] * 7), "item 2 (MAVLink command 4711): no action does it"),
        (simple(16, [0, 0, 0, 0, 0, 0, 25]), "item 2 has no latitude and longitude"),
        (simple(21, [0] * 7), "item 2 (land) has no latitude and longitude, and nothing was flown"),
        (simple(93, [-1, 12, 0, 0, 0, 0, 0], 2), "item 2 is a delay until a time of day"),
        (WAYPOINT | {"autoContinue": False}, "item 2 waits for a person before the next one"),
        (simple(178, [2, 3, -1, 0, 0, 0, 0], 2), "item 2 (change of the vertical speed): no action does it"),
        ({"type": "ComplexItem", "complexItemType": "fwLandingPattern"}, "item 2 (fwLandingPattern): no action"),
        (scan(distance_m=3.0), "item 2 (corridor scan) takes images along its way"),
        (
            survey(style={"TurnAroundDistance": 10, "HoverAndCapture": True}, flyAlternateTransects=True),
            "item 2 (survey): the coverage plans its own lines, without the turnarounds of 10 m, the stop at each "
            "image, the alternate order of lines",
        ),
        (survey(camera={"FrontalOverlap": 98}), "item 2 (survey): overlaps above 95 %, which become 95 %"),
    ],
)
def test_what_a_mission_can_not_have_is_named_as_lost(item: dict[str, Any], note: str) -> None:
    assert any(found.startswith(note) for found in import_plan(plan(TAKEOFF, item), "field").lost)


@pytest.mark.parametrize(
    ("command", "words"),
    [(82, "spline waypoint"), (17, "loiter unlimited"), (18, "loiter turns"), (31, "loiter to an altitude")],
)
def test_splines_and_loiters_are_flown_as_places_with_a_note(command: int, words: str, tmp_path: Path) -> None:
    item = simple(command, [3, 0, 20, 0, 47.3980, 8.5460, 25])
    made = import_plan(plan(TAKEOFF, WAYPOINT, item, WAYPOINT), "field")
    points = [goal["target_ned_m"] for action, goal in goals_of(made, tmp_path) if action == "go_to"]
    assert len(points) == 3 and points[1] == pytest.approx([28.69, 30.56, -25.0], abs=0.05)
    assert made.notes == [f"item 3 ({words}) is a waypoint, to which the vehicle flies straight"] and made.lost == []


@pytest.mark.parametrize("kind", ["CorridorScan", "StructureScan"])
def test_a_scan_is_flown_by_the_items_that_it_has(kind: str, tmp_path: Path) -> None:
    made = import_plan(plan(TAKEOFF, scan(kind)), "field")
    assert list(made.points) == ["waypoint_2_1", "waypoint_2_3"]
    assert made.points["waypoint_2_3"]["altitude_m"] == {"amsl_m": 7.0}
    none: list[Any] = [[], None, "x"]
    for items in none:
        with pytest.raises(AreaFileError, match=r"item 2 \((corridor|structure) scan\) has no waypoints of its own"):
            import_plan(plan(TAKEOFF, scan(kind, items=items)), "field")


def test_a_plan_without_a_takeoff_says_that_it_begins_in_the_air() -> None:
    assert import_plan(plan(WAYPOINT), "field").notes == [
        "the plan has no takeoff at its begin: fly it from a hover, or add the step takeoff"
    ]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"fileType": "Mission"}, 'is not a plan of QGroundControl: it has no "fileType": "Plan"'),
        (plan(), "has nothing to fly, no takeoff, waypoint, survey or landing"),
        (plan(simple(177, [1, 2, 0, 0, 0, 0, 0], 2)), r"has nothing to fly, .* landing: item 1 \(do jump\): no action"),
        (plan(TAKEOFF) | {"version": 42}, 'is a plan of version "42", and 1 is read: open it'),
        (plan(survey(version=3)), r'item 1 \(survey\) is of version "3", and 4 and 5 are read'),
        (plan(TAKEOFF | {"params": [1, 2, 3]}), "item 1 has 3 parameters, and a command of MAVLink has 7"),
        (plan(simple(22, [0, 0, 0, None, 47.0, 8.0, None])), "item 1 has no altitude"),
        (plan(survey(camera={"DistanceToSurface": None})), r"item 1 \(survey\) has no altitude"),
        (plan(survey(polygon=[[1, 2]])), "survey 1 has 1 corner, and an area needs three"),
        (plan(simple(16, [0, 0, 0, None, 147.0, 8.0, 5])), "item 1: 147, 8 is no latitude and longitude"),
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
                read_mission(tmp_path / "mission.yaml", HOME_DEG)
        made += 1
    assert made > 500
