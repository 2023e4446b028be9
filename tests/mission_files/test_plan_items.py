"""Older files of other programs: missions of QGroundControl before 2017, and texts of waypoints."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.area_files import AreaFileError
from jezero.mission_files.imported import ImportedMission
from jezero.mission_files.other_programs import import_file
from jezero.mission_files.plan_items import plan_of_mission, plan_of_waypoints
from jezero.mission_files.qgc_import import import_plan
from tests.mission_files.qgc import written
from tests.mission_files.test_qgc_import import mutations

HOME = [47.397742, 8.545594, 488]


def imported(file: Path) -> ImportedMission:
    return import_file(file, 8.0, 0.7)


def old_item(command: int, place: list[float], frame: int = 3, **fields: Any) -> dict[str, Any]:
    """An item of 2016, with a parameter in each field."""
    params = {f"param{number}": 0 for number in range(1, 5)}
    item = {"type": "missionItem", "command": command, "frame": frame, "coordinate": place, "autoContinue": True}
    return item | params | fields


def test_a_mission_of_2016_is_read(tmp_path: Path) -> None:
    content = {
        "MAV_AUTOPILOT": 12, "version": "1.0", "groundStation": "QGroundControl", "complexItems": [],
        "plannedHomePosition": old_item(16, [47.397742, 8.545594, 488], 0),
        "items": [old_item(22, [47.397742, 8.545594, 4]), old_item(16, [47.3980, 8.5460, 494], 0, param1=3)],
    }  # fmt: skip
    made = imported(written(tmp_path, content, "old.mission"))
    assert made.steps[0] == {"takeoff": {"altitude_m": 4.0}} and made.steps[-1] == {"wait": 3.0}
    assert made.points["waypoint_2"] == {"degrees": [47.398, 8.546], "altitude_m": {"amsl_m": 494.0}}
    assert made.home_altitude_m == 488.0


def test_a_mission_of_version_2_and_a_plan_with_coordinates_mean_the_same(tmp_path: Path) -> None:
    item = {
        "type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, 0], "coordinate": [47.3980, 8.5460, 5],
        "autoContinue": True, "doJumpId": 1,
    }  # fmt: skip
    mission = {"version": 2, "fileType": "Mission", "items": [item], "plannedHomePosition": HOME}
    plan = {"version": 1, "fileType": "Plan", "mission": mission, "geoFence": {"version": 1, "polygon": []}}
    for content, name in ((mission, "old.mission"), (plan, "old.plan"), (plan, "plan.mission")):
        made = imported(written(tmp_path, content, name))
        assert made.points == {"waypoint_1": {"degrees": [47.398, 8.546], "altitude_m": 5.0}}


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"version": 7}, 'is a mission of version "7", and 1 and 2 are read'),
        ({}, 'is a mission of version "None", and 1 and 2 are read'),
        ({"version": "1.0", "complexItems": [{"type": "complexItem"}]}, "has surveys of a version that is too old"),
        ([1], 'is not a plan of QGroundControl: it has no "fileType": "Plan"'),
    ],
)
def test_missions_of_other_versions_are_refused_by_their_version(content: Any, why: str, tmp_path: Path) -> None:
    with pytest.raises(AreaFileError, match=why):
        imported(written(tmp_path, content, "old.mission"))


def test_no_old_mission_with_junk_in_it_breaks_the_import(tmp_path: Path) -> None:
    whole = {
        "version": 1, "plannedHomePosition": old_item(16, [47.3977, 8.5455, 488], 0),
        "items": [old_item(22, [47.3977, 8.5455, 4]), old_item(16, [47.3980, 8.5460, 494], 0)],
    }  # fmt: skip
    for content in mutations(whole):
        with suppress(AreaFileError):
            import_plan(plan_of_mission(content) if isinstance(content, dict) else content, "old").to_yaml()


WAYPOINTS = (
    "QGC WPL 110",
    "0\t1\t0\t16\t0\t0\t0\t0\t47.397742\t8.545594\t488\t1",
    "1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t4\t1",
    "2\t0\t3\t16\t2\t0\t0\t90\t47.39783193\t8.545594\t5\t1",
    "3\t0\t0\t16\t0\t0\t0\t0\t47.39783193\t8.545594\t494.5\t1",
    "4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1",
)


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(WAYPOINTS),
        "\r\n".join([*WAYPOINTS, "", ""]),
        "\ufeff" + "\n".join(WAYPOINTS),
        "\n".join(WAYPOINTS).replace("\t", "   "),
        "\n".join(["", WAYPOINTS[0], "# a comment", *WAYPOINTS[1:]]),
        "\n".join(["QGC WPL 120", *WAYPOINTS[2:]]),
    ],
)
@pytest.mark.parametrize("name", ["a.waypoints", "a.txt", "a.mission", "a.plan"])
def test_waypoints_are_read_without_their_first_line_which_is_home(text: str, name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    made = imported(file)
    (first, second) = made.points.values()
    assert first == {"degrees": [47.39783193, 8.545594], "altitude_m": 5.0}
    assert second["altitude_m"] == {"amsl_m": 494.5}
    assert [next(iter(step)) for step in made.steps] == ["takeoff", "go_to", "wait", "go_to", "return_home"]
    assert "yaw_rad" in made.steps[1]["go_to"] and "yaw_rad" not in made.steps[3]["go_to"]
    assert made.home_altitude_m == (None if "120" in text else 488.0)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", 'has no waypoints: their first line is "QGC WPL 110"'),
        ("hello", 'has no waypoints: their first line is "QGC WPL 110"'),
        ("QGC WPL 100\n" + WAYPOINTS[1], 'has waypoints of version "100", and 110 and 120 are read'),
        ("QGC WPL 110\n1 2 3", 'line 2: "1 2 3" is no waypoint: it needs 12 numbers'),
        ("\n".join([*WAYPOINTS, WAYPOINTS[2].replace("22", "x")]), 'line 7: "1 0 3 x '),
        ("\n".join([*WAYPOINTS, WAYPOINTS[2].replace("\t4\t", "\tnan\t")]), "line 7: "),
        ("\n".join([*WAYPOINTS, WAYPOINTS[2].replace("\t3\t", "\t10\t")]), "item 5 is at 4 m over the terrain"),
        (WAYPOINTS[0], "has nothing to fly"),
    ],
)
def test_what_are_no_waypoints_is_refused_with_its_line(text: str, why: str, tmp_path: Path) -> None:
    file = tmp_path / "a.waypoints"
    file.write_text(text)
    with pytest.raises(AreaFileError, match=why) as refused:
        imported(file)
    assert str(refused.value).startswith(f"{file}: ")


def test_a_line_after_which_the_vehicle_waits_for_a_person_is_lost(tmp_path: Path) -> None:
    file = tmp_path / "a.waypoints"
    file.write_text("\n".join(WAYPOINTS).replace("\t5\t1", "\t5\t0"))
    assert imported(file).lost == ["item 2 waits for a person before the next one (autoContinue is false)"]


@settings(max_examples=60)
@given(
    st.lists(
        st.sampled_from(["0", "1", "3", "16", "22", "-1", "47.4", "8.5", "1e308", "nan", "x", "\x00"]), max_size=30
    )
)
def test_no_text_of_waypoints_breaks_the_import(words: list[str]) -> None:
    lines = ["\t".join(words[at : at + 12]) for at in range(0, len(words), 12)]
    with suppress(AreaFileError):
        import_plan(plan_of_waypoints("\n".join(["QGC WPL 120", *lines])), "text").to_yaml()
