"""Mission files: what they become, and how each mistake is named."""

from pathlib import Path

import pytest

from jezero.mission_files import MissionFileError, read_mission
from jezero.schemas.mission import STEPS_MAX, FailurePolicy, GoalStep, WaitStep

FIELDS = Path(__file__).parents[2] / "docs" / "how-to" / "fields"
ORIGIN_DEG = (47.397742, 8.545594)
GOOD = """\
mission: survey
points:
  rock: [4, 3, -2]
  base: [0, 0, -3]
areas:
  square: [[-3, -3], [3, -3], [3, 3], [-3, 3]]
on_failure: {retries: 1, then: return}
steps:
  - takeoff: {altitude_m: 2}
  - go_to: {target_ned_m: rock, speed_mps: 1e0}
  - wait: 2
  - repeat:
      times: 2
      steps:
        - for_each:
            spot: [rock, base, [1, 1, -2]]
            steps:
              - get_images: {center_ned_m: spot, radius_m: 3, num_images: 4}
                on_failure: {then: skip}
  - area_coverage: {polygon_ned_m: square, z_ned_m: -5, resolution_m: 1}
  - land_on_spot
"""


RALLY = (
    "rally_points: [rock, [20, -15]]\nsteps:\n  - return_home\n  - go_to: {target_ned_m: rock}\n  - return_home: {}\n"
)


def written(tmp_path: Path, text: str | bytes, name: str = "survey.yaml") -> Path:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_file_becomes_a_list_of_goals_with_loops_written_out_and_names_in_place(tmp_path: Path) -> None:
    read = read_mission(written(tmp_path, GOOD))
    steps = read.mission.steps
    assert read.mission.name == "survey"
    assert read.lines == (9, 10, 11, *(18,) * 6, 20, 21)
    assert isinstance(steps[1], GoalStep)
    assert steps[1].goal == {"target_ned_m": [4.0, 3.0, -2.0], "speed_mps": 1.0}
    assert (steps[1].label, steps[1].on_failure) == ("go to (rock)", FailurePolicy(retries=1, then="return"))
    assert steps[2] == WaitStep(label="wait 2 s", duration_s=2.0)
    centers = [step.goal["center_ned_m"] for step in steps[3:9] if isinstance(step, GoalStep)]
    assert [step.label for step in steps[3:6]] == [
        "get images (rock)", "get images (base)", "get images (1, 1, -2)",
    ]  # fmt: skip
    assert centers == [[4.0, 3.0, -2.0], [0.0, 0.0, -3.0], [1.0, 1.0, -2.0]] * 2
    assert isinstance(steps[3], GoalStep)
    assert steps[3].on_failure == FailurePolicy(then="skip")
    assert isinstance(steps[-1], GoalStep)
    assert (steps[-1].action, steps[-1].goal) == ("land_on_spot", {})


def test_json_is_read_as_well(tmp_path: Path) -> None:
    text = '{"mission": "up", "steps": [{"takeoff": {"altitude_m": 3}}, {"wait": 1.5}]}'
    assert [step.label for step in read_mission(written(tmp_path, text, "up.json")).mission.steps] == [
        "takeoff",
        "wait 1.5 s",
    ]


def test_an_area_of_a_file_brings_its_holes_and_its_origin(tmp_path: Path) -> None:
    text = f"""\
areas:
  a: {FIELDS / "field.kml"}
  b: {{file: {FIELDS / "field_in_metres.geojson"}, metres: true}}
steps:
  - area_coverage: {{polygon_ned_m: a, z_ned_m: -5, resolution_m: 2}}
  - area_coverage: {{polygon_ned_m: b, z_ned_m: -5, resolution_m: 2}}
"""
    first, second = (step.goal for step in read_mission(written(tmp_path, text), ORIGIN_DEG).mission.steps)  # type: ignore[union-attr]
    assert len(first["polygon_ned_m"]) >= 4
    assert first["origin_deg"] == ORIGIN_DEG
    assert "origin_deg" not in second
    assert first["polygon_ned_m"][0] == pytest.approx(second["polygon_ned_m"][0], abs=0.05)


HEAD = "points: {rock: [4, 3, -2]}\nareas: {square: [[0, 0], [0, 5], [5, 5]]}\nsteps:\n"
WRONG = [
    ("", 1, "is empty"),
    ("- takeoff\n", 1, "is a list: a mission has a list of steps under `steps:`"),
    ("just words\n", 1, "is the text 'just words'"),
    (b"\xff\xfe\x00", 1, "is no text in UTF-8"),
    ("steps:\n  - go_to: {target_ned_m: [1, 2\n", 3, "is no YAML"),
    ("steps:\n\t- takeoff\n", 2, "is no YAML"),
    ("steps:\n  - &a takeoff\n  - *a\n", 2, "anchors and aliases"),
    ("mission: x\n", 1, "the mission has no steps"),
    ("steps: []\n", 1, "steps are a list with one step or more, not a list"),
    ("steps: takeoff\n", 1, "steps are a list with one step or more, not the text 'takeoff'"),
    ("pionts: {}\nsteps: [takeoff]\n", 1, "there is no part of a mission 'pionts'; did you mean 'points'?"),
    ("mission: my survey\nsteps: [takeoff]\n", 1, "the mission's name has letters, digits"),
    ("points: [1, 2]\nsteps: [takeoff]\n", 1, "points are written as `name: value`, not as a list"),
    ("points: {rock: [4, 3]}\nsteps: [takeoff]\n", 1, "the point 'rock' needs [north, east, down] in metres"),
    ("areas: {a: [[1, 2], [3, 4]]}\nsteps: [takeoff]\n", 1, "the area 'a' needs three corners or more"),
    ("areas: {a: nowhere.kml}\nsteps: [takeoff]\n", 1, "nowhere.kml can't be read: No such file"),
    ("areas: {a: 7}\nsteps: [takeoff]\n", 1, "the area 'a' is a list of corners [north, east], or the name of a file"),
    ("areas: {a: {fiel: x}}\nsteps: [takeoff]\n", 1, "the area 'a' needs {file: NAME}"),
    ("on_failure: {retries: 99}\nsteps: [takeoff]\n", 1, "retries: expected a whole number from 0 to 10"),
    ("on_failure: {then: cry}\nsteps: [takeoff]\n", 1, "then: stop, skip, return or land"),
    (HEAD + "  - fly_velocity: {speed_max_mps: 2}\n", 4, "fly_velocity follows the commands of a client"),
    (HEAD + "  - takeof: {altitude_m: 2}\n", 4, "there is no action 'takeof'; did you mean 'takeoff'?"),
    (HEAD + "  - go_to: {target_ned_m: rok}\n", 4, "no point or area 'rok'; did you mean 'rock'? Known are rock"),
    (HEAD + "  - go_to: {target_ned_m: square}\n", 4, "'square' is an area, and target_ned_m is a point"),
    (HEAD + "  - go_to: {taget_ned_m: rock}\n", 4, "go_to: there is no field 'taget_ned_m'; did you mean 'target_"),
    (HEAD + "  - go_to: {target_ned_m: [1, 2]}\n", 4, "target_ned_m: expected a list of length 3, not 2"),
    (HEAD + "  - go_to\n", 4, "go_to: target_ned_m is missing"),
    (HEAD + "  - takeoff: 2\n", 4, "takeoff needs fields, as in `takeoff: {field: value}`, not 2"),
    (HEAD + "  - takeoff: {altitude_m: high}\n", 4, "altitude_m: expected a number, not a text"),
    (HEAD + "  - takeoff:\n      altitude_m: 2\n      altitude_m: 3\n", 6, "'altitude_m' stands here twice"),
    (HEAD + "  - takeoff: {goal_id: x}\n", 4, "goal_id is chosen when the mission is flown: leave it out"),
    (HEAD + "  - takeoff: {}\n    land_on_spot: {}\n", 4, "a step has one action, not takeoff, land_on_spot"),
    (HEAD + "  - 7\n", 4, "a step is `action: {field: value}`, not 7"),
    (HEAD + "  - wait: soon\n", 4, "wait needs seconds, 0 to 3600, not the text 'soon'"),
    (HEAD + "  - wait: -1\n", 4, "wait needs seconds, 0 to 3600, not -1"),
    (HEAD + "  - wait: 1\n    on_failure: {}\n", 5, "wait has no on_failure: give it to its steps"),
    (HEAD + "  - repeat: {times: 0, steps: [takeoff]}\n", 4, "repeat needs {times: 1 to 100, steps: [...]}"),
    (HEAD + "  - for_each: {rock: [[1, 2, 3]], steps: [takeoff]}\n", 4, "'rock' is a point or an area already"),
    (HEAD + "  - for_each: {spot: [rock, rok], steps: [takeoff]}\n", 4, "there is no point 'rok'; did you mean"),
    (HEAD + "  - for_each: {spot: [], steps: [takeoff]}\n", 4, "for_each has no points"),
    (HEAD + "  - for_each: {spot: [[1, 2]], steps: [takeoff]}\n", 4, "a point is a name, or [north, east, down]"),
    (HEAD + "  - repeat: {times: 100, steps: [repeat: {times: 100, steps: [takeoff]}]}\n", 4, f"more than {STEPS_MAX}"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line", "words"), WRONG, ids=[words[:40] for _, _, words in WRONG])
def test_a_mistake_is_named_with_its_line(tmp_path: Path, text: str | bytes, line: int, words: str) -> None:
    with pytest.raises(MissionFileError) as caught:
        read_mission(written(tmp_path, text))
    assert any(problem.line == line and words in problem.text for problem in caught.value.problems), str(caught.value)


def test_all_mistakes_are_named_at_once_by_line(tmp_path: Path) -> None:
    with pytest.raises(MissionFileError) as caught:
        read_mission(written(tmp_path, HEAD + "  - takeof\n  - wait: soon\n  - go_to\n"))
    assert [problem.line for problem in caught.value.problems] == [4, 5, 6]
    assert str(caught.value).count("survey.yaml, line ") == 3


def test_a_file_that_is_not_there_or_too_big_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissionFileError, match=r"none\.yaml can't be read: No such file"):
        read_mission(tmp_path / "none.yaml")
    with pytest.raises(MissionFileError, match="has 2 MB, and a mission has 1 at most"):
        read_mission(written(tmp_path, "#" * 2_000_000))


def test_points_and_areas_in_degrees_are_placed_around_the_origin(tmp_path: Path) -> None:
    text = (
        "points:\n  mast: {degrees: [47.397842, 8.545594], altitude_m: 12}\n"
        "areas:\n  field: {degrees: [[47.3978, 8.5456], [47.3979, 8.5456], [47.3979, 8.5457]]}\n"
        "steps:\n  - go_to: {target_ned_m: mast}\n"
        "  - area_coverage: {polygon_ned_m: field, z_ned_m: -5, resolution_m: 1}\n"
    )
    go_to, coverage = read_mission(written(tmp_path, text), ORIGIN_DEG).mission.steps
    assert isinstance(go_to, GoalStep) and isinstance(coverage, GoalStep)
    assert go_to.goal["target_ned_m"] == pytest.approx([11.12, 0.0, -12.0], abs=0.01)
    assert coverage.goal["origin_deg"] == ORIGIN_DEG
    assert len(coverage.goal["polygon_ned_m"]) == 3


@pytest.mark.parametrize(
    ("place", "origin_deg", "sentence"),
    [
        ("points: {a: {degrees: [47.4, 8.5]}}", ORIGIN_DEG, "or {degrees: [latitude, longitude], altitude_m: 3}"),
        ("points: {a: {degrees: [47.4], altitude_m: 1}}", ORIGIN_DEG, "the point 'a' needs [north, east, down]"),
        (
            "points: {a: {degrees: [8.5, 47.4], altitude_m: 1}}",
            ORIGIN_DEG,
            "km from the world's origin, which is at 47.39",
        ),
        (
            "points: {a: {degrees: [47.4, 8.5], altitude_m: 1}}",
            None,
            "is in degrees, and the world's origin is not known",
        ),
        ("areas: {a: {degrees: [[47.4, 8.5], [47.4, 8.6]]}}", ORIGIN_DEG, "has 2 corners, and an area needs three"),
        (
            "areas: {a: {degrees: [[47.4, 8.5], 3, [47, 8]]}}",
            ORIGIN_DEG,
            "needs {degrees: [[latitude, longitude], ...]",
        ),
        ("areas: {a: {degrees: 3, hole: []}}", ORIGIN_DEG, "needs {degrees: [[latitude, longitude], ...]"),
        ("areas: {a: {degrees: [[47.4, 8.5], [47.5, 8.5], [47, 8]]}}", None, "the world's origin is not known yet"),
    ],
)
def test_a_wrong_place_in_degrees_is_named(
    place: str, origin_deg: tuple[float, float] | None, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(MissionFileError) as error:
        read_mission(written(tmp_path, f"{place}\nsteps: [takeoff]\n"), origin_deg)
    assert [problem.line for problem in error.value.problems] == [1]
    assert sentence in str(error.value)


def test_rally_points_are_those_of_the_mission_and_of_its_returns(tmp_path: Path) -> None:
    own = "  - return_home: {rally_points_ned_m: [[1, 1]]}\n"
    mission = read_mission(written(tmp_path, "points: {rock: [4, 3, -2]}\n" + RALLY + own)).mission
    assert mission.rally_points_ned_m == ((4.0, 3.0), (20.0, -15.0))
    goals = [step.goal.get("rally_points_ned_m") for step in mission.steps if isinstance(step, GoalStep)]
    assert goals == [[[4.0, 3.0], [20.0, -15.0]], None, [[4.0, 3.0], [20.0, -15.0]], [[1, 1]]]


@pytest.mark.parametrize("points", ["rock", "[rok]", "[[1]]", "[[1, 2, 3]]", "{a: [1, 2]}", "[[1, x]]"])
def test_what_are_no_rally_points_is_named_with_its_line(points: str, tmp_path: Path) -> None:
    text = "points: {rock: [4, 3, -2]}\n" + RALLY.replace("[rock, [20, -15]]", points)
    with pytest.raises(MissionFileError, match="line 2: rally_points are a list with names of points, or"):
        read_mission(written(tmp_path, text))


def test_waypoints_of_another_program_are_no_mission_yet_and_a_text_may_be_one(tmp_path: Path) -> None:
    with pytest.raises(
        MissionFileError, match=r"a\.txt is no mission of jezero yet: jezero mission import .* makes one"
    ):
        read_mission(written(tmp_path, "QGC WPL 110\n", "a.txt"))
    assert len(read_mission(written(tmp_path, "steps: [{wait: 1}]\n", "b.txt")).mission.steps) == 1


def test_too_many_rally_points_are_named(tmp_path: Path) -> None:
    with pytest.raises(MissionFileError, match="a mission has 100 rally points at most, not 101"):
        read_mission(
            written(tmp_path, "points: {rock: [4, 3, -2]}\n" + RALLY.replace("[20, -15]", ", ".join(["rock"] * 100)))
        )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("points: {a: {degrees: [47.4, 8.5], altitude_m: {amsl: 5}}}\n", "needs a number, or {amsl_m: NUMBER}"),
        ("points: {a: {degrees: [47.4, 8.5], altitude_m: {amsl_m: x}}}\n", "needs a number, or {amsl_m: NUMBER}"),
        ("points: {a: {degrees: [47.4, 8.5], altitude_m: {amsl_m: 5, x: 3}}}\n", "needs a number, or {amsl_m: NUMBER}"),
        ("points: {a: {degrees: [47.4, 8.5], altitude_m: [5]}}\n", "the point 'a' needs"),
        (
            "steps: [{takeoff: {altitude_m: {amsl_m: 480}}}]\n",
            "8.0 m below the world's origin, which is 488 m above sea",
        ),
        ("steps: [{takeoff: {altitude_m: {up: 480}}}]\n", "altitude_m needs a number, or {amsl_m: NUMBER}"),
        ("steps: [{go_to: {target_ned_m: [1, 2, {amsl_m: 500}]}}]\n", "expected a number"),
    ],
)
def test_a_height_above_sea_level_that_is_none_is_named(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(MissionFileError) as refused:
        read_mission(written(tmp_path, text), (*ORIGIN_DEG, 488.0))
    assert why in str(refused.value)
