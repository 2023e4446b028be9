"""Forms from the goal types, and goals from what was typed."""

import msgspec
import pytest

from jezero.schemas.topics import ACTIONS, AREA_COVERAGE, GET_IMAGES, GO_TO, TAKEOFF
from jezero.services.ground_station.goal_form import Field, form_of, goal_from


def fields_of(name: str) -> dict[str, Field]:
    return {field.name: field for field in form_of(ACTIONS[name].description.goal)[1]}


@pytest.mark.parametrize("name", ACTIONS)
def test_every_field_that_a_goal_needs_is_in_its_form(name: str) -> None:
    needed = {field.name for field in msgspec.structs.fields(ACTIONS[name].goal_type) if field.required}
    assert needed <= set(fields_of(name))


def test_a_form_has_the_units_ranges_and_defaults_of_the_goal_type() -> None:
    altitude = fields_of("takeoff")["altitude_m"]
    assert (altitude.label, altitude.unit, altitude.kind, altitude.default) == ("altitude", "m", "number", 2.0)
    assert altitude.help == "target altitude above the take-off point, positive up."
    overlap = fields_of("area_coverage")["overlap"]
    assert overlap.range_words == "0 to 0.95"
    target = fields_of("go_to")["target_ned_m"]
    assert (target.kind, target.axes, target.required) == ("vector", ("north", "east", "down"), True)
    assert fields_of("area_coverage")["polygon_ned_m"].kind == "area"
    assert fields_of("area_coverage")["holes_ned_m"].kind == "areas"
    assert fields_of("land_on_spot")["use_uwb"].kind == "switch"


def test_typed_text_becomes_a_goal() -> None:
    _, fields = form_of(GO_TO.description.goal)
    values = {"target_ned_m": ["1", "-2.5", "-3"], "frame": "world", "do_takeoff": True, "speed_mps": ""}
    goal, problems = goal_from(fields, values)
    assert not problems
    assert goal == {"target_ned_m": [1.0, -2.5, -3.0], "frame": "world", "do_takeoff": True}
    msgspec.convert(goal, GO_TO.goal_type)


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [("high", "'high' is no number"), ("nan", "altitude must be a number"), ("inf", "altitude must be a number")],
)
def test_what_is_no_number_is_told_at_its_field(typed: str, sentence: str) -> None:
    goal, problems = goal_from(form_of(TAKEOFF.description.goal)[1], {"altitude_m": typed})
    assert problems == {"altitude_m": sentence}
    assert "altitude_m" not in goal


def test_a_number_out_of_range_is_told_with_its_range() -> None:
    _, problems = goal_from(form_of(AREA_COVERAGE.description.goal)[1], {"overlap": "1.5"})
    assert problems["overlap"] == "overlap must be a number 0 to 0.95"


def test_missing_fields_are_told() -> None:
    fields = form_of(GET_IMAGES.description.goal)[1]
    _, problems = goal_from(fields, {"center_ned_m": ["1", "", "-5"], "num_images": "2.5"})
    assert problems == {
        "center_ned_m": "center needs all of north, east, down",
        "radius_m": "radius is needed",
        "num_images": "num images is a whole number",
    }


def test_an_area_needs_three_corners() -> None:
    fields = [field for field in form_of(AREA_COVERAGE.description.goal)[1] if field.name == "polygon_ned_m"]
    assert goal_from(fields, {})[1] == {"polygon_ned_m": "draw the area on the map: click its corners"}
    assert "2 corners" in goal_from(fields, {"polygon_ned_m": [[0, 0], [1, 1]]})[1]["polygon_ned_m"]
    assert goal_from(fields, {"polygon_ned_m": [[0, 0], [1, 1], [1, 0]]})[0] == {
        "polygon_ned_m": [[0, 0], [1, 1], [1, 0]]
    }
