"""Forms from the goal types, goals from what was typed, and their confirmation."""

from math import radians

import msgspec
import pytest

from jezero.schemas.actions import PlanReply
from jezero.schemas.topics import ACTIONS, AREA_COVERAGE, GET_IMAGES, GO_TO, TAKEOFF
from jezero.services.ground_station.goal_form import (
    CONFIRMATION_TIMEOUT_S,
    Confirmation,
    FormField,
    form_of,
    goal_from,
    named_field,
)


def fields_of(name: str) -> dict[str, FormField]:
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
    assert (target.kind, target.axes, target.required) == ("vector", ("north", "east", "height"), True)
    assert fields_of("area_coverage")["polygon_ned_m"].kind == "area"
    assert fields_of("area_coverage")["holes_ned_m"].kind == "areas"
    assert fields_of("land_on_spot")["use_uwb"].kind == "switch"


def test_typed_text_becomes_a_goal() -> None:
    _, fields = form_of(GO_TO.description.goal)
    values = {"target_ned_m": ["1", "-2.5", "3"], "frame": "world", "do_takeoff": True, "speed_mps": ""}
    goal, problems = goal_from(fields, values)
    assert not problems
    assert goal == {"target_ned_m": [1.0, -2.5, -3.0], "frame": "world", "do_takeoff": True}
    msgspec.convert(goal, GO_TO.goal_type)


def test_heights_are_typed_above_the_start_positive_up_and_sent_as_z() -> None:
    center = fields_of("get_images")["center_ned_m"]
    target = fields_of("get_images")["target_z_ned_m"]
    assert (target.label, target.default, str(target.default)) == ("target height", 0.0, "0.0")
    assert "negative" not in center.help + target.help
    goal, _ = goal_from([center, target], {"center_ned_m": ["1", "2", "5"], "target_z_ned_m": "0.2"}, -0.5)
    assert goal == {"center_ned_m": [1.0, 2.0, -5.5], "target_z_ned_m": -0.7}


def test_several_choices_become_a_list() -> None:
    override = fields_of("takeoff")["override"]
    assert (override.kind, override.required) == ("choices", False)
    assert {"battery", "services"} <= set(override.choices)
    goal, problems = goal_from([override], {"override": ["battery", "storage"]})
    assert not problems
    assert goal == {"override": ["battery", "storage"]}
    assert goal_from([override], {"override": []})[0] == {}


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [
        ("high", "altitude: expected a number, not a text"),
        ("nan", "altitude: expected a number"),
        ("inf", "altitude: expected a number"),
    ],
)
def test_what_is_no_number_is_told_at_its_field(typed: str, sentence: str) -> None:
    goal, problems = goal_from(form_of(TAKEOFF.description.goal)[1], {"altitude_m": typed})
    assert problems == {"altitude_m": sentence}
    assert "altitude_m" not in goal


def test_a_number_out_of_range_is_told_with_its_range() -> None:
    _, problems = goal_from(form_of(AREA_COVERAGE.description.goal)[1], {"overlap": "1.5"})
    assert problems["overlap"] == "overlap: expected a number from 0 to 0.95"


def test_an_emptied_number_is_not_flown_with_the_number_that_it_stands_for() -> None:
    fields = form_of(TAKEOFF.description.goal)[1]
    assert goal_from(fields, {"altitude_m": ""})[1] == {"altitude_m": "altitude is missing"}
    speed = [field for field in form_of(GO_TO.description.goal)[1] if field.name == "speed_mps"]
    assert goal_from(speed, {"speed_mps": ""}) == ({}, {})  # the vehicle chooses it, as the form says


def test_missing_fields_are_told() -> None:
    fields = form_of(GET_IMAGES.description.goal)[1]
    _, problems = goal_from(fields, {"center_ned_m": ["1", "", "5"], "num_images": "2.5"})
    assert problems == {
        "center_ned_m": "center needs all of north, east, height",
        "radius_m": "radius is missing",
        "num_images": "num images: expected a whole number, not 2.5",
    }


def test_an_area_needs_three_corners() -> None:
    fields = [field for field in form_of(AREA_COVERAGE.description.goal)[1] if field.name == "polygon_ned_m"]
    assert goal_from(fields, {})[1] == {"polygon_ned_m": "Draw the area on the map: click its corners"}
    assert "2 corners" in goal_from(fields, {"polygon_ned_m": [[0, 0], [1, 1]]})[1]["polygon_ned_m"]
    assert goal_from(fields, {"polygon_ned_m": [[0, 0], [1, 1], [1, 0]]})[0] == {
        "polygon_ned_m": [[0, 0], [1, 1], [1, 0]]
    }


@pytest.mark.parametrize(
    ("action", "reason", "field"),
    [
        ("takeoff", "altitude 9000 m is not within 1 to 120 m above the ground", "altitude_m"),
        ("go_to", "target z = 3 m is not above the ground: NED counts down, 5 m up is −5", "target_ned_m"),
        ("go_to", "speed 20 m/s is not within 0.1 to 10 m/s", "speed_mps"),
        ("go_to", "Expected `float` <= 6.2832 - at `$.yaw_rad`", "yaw_rad"),
        ("go_to", "busy: goal a of area_coverage is running (status 10 COVERAGE)", ""),
        ("get_images", "num_images 300 is not within 1 to 255", "num_images"),
        ("get_images", "radius 0.1 m is too small: the vehicle flies around at 1 m or more", "radius_m"),
        ("area_coverage", "hole 2 is not wholly inside the polygon: correct it, or leave it out", "holes_ned_m"),
        ("area_coverage", "the polygon crosses or touches itself at 1.00 m north, 2.00 m east", "polygon_ned_m"),
        ("land_on_spot", "landing_spot_ned_m is missing: it is needed without use_uwb", "landing_spot_ned_m"),
        ("land_on_spot", "the wind of 12 m/s is stronger than 8 m/s", ""),
    ],
)  # fmt: skip
def test_a_refusal_belongs_to_the_field_that_it_names_first(action: str, reason: str, field: str) -> None:
    assert named_field(reason, form_of(ACTIONS[action].description.goal)[1]) == field


def test_an_angle_is_typed_in_degrees_and_sent_in_radians() -> None:
    yaw = fields_of("go_to")["yaw_rad"]
    assert (yaw.label, yaw.unit, yaw.minimum, yaw.maximum) == ("yaw", "°", -360.0, 360.0)
    goal, problems = goal_from([yaw], {"yaw_rad": "90"})
    assert not problems
    assert goal["yaw_rad"] == pytest.approx(radians(90.0))


PATH = ((0.0, 0.0, -2.5), (0.0, 0.0, -6.5), (9.0, 0.0, -3.0))
PLAN = PlanReply(accepted=True, duration_s=34.2, distance_m=41.3, battery_used=0.048, path_ned_m=PATH)


def test_the_button_says_time_length_battery_and_highest_point_above_the_start() -> None:
    asked = Confirmation({}, {}, PLAN, 0.0)
    assert asked.words(0.0) == "Confirm: 34 s, 41 m, 5 % of the battery, up to 6.5 m"
    assert asked.words(-0.5) == "Confirm: 34 s, 41 m, 5 % of the battery, up to 6 m"


@pytest.mark.parametrize(("used", "words"), [(0.0, "0 %"), (0.001, "1 %"), (0.05, "5 %"), (0.0514, "6 %")])
def test_the_battery_is_rounded_up(used: float, words: str) -> None:
    assert Confirmation({}, {}, PlanReply(accepted=True, battery_used=used), 0.0).words(0.0) == (
        f"Confirm: {words} of the battery"
    )


def test_a_plan_without_figures_is_confirmed_without_figures() -> None:
    assert Confirmation({}, {}, PlanReply(accepted=True), 0.0).words(0.0) == "Confirm"


def test_a_confirmation_holds_for_the_planned_goal_and_for_a_minute() -> None:
    asked = Confirmation({"altitude_m": 3.0}, {"altitude_m": "3"}, PLAN, 10.0)
    assert asked.holds_for({"altitude_m": "3"}, 10.0 + CONFIRMATION_TIMEOUT_S)
    assert not asked.holds_for({"altitude_m": "3"}, 10.1 + CONFIRMATION_TIMEOUT_S)
    assert not asked.holds_for({"altitude_m": "30"}, 11.0)
