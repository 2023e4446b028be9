"""One mistake has one sentence, whichever way a goal is given."""

import shlex
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
from click.testing import CliRunner

from jezero.base.codec import BadPayloadError, decode, decode_request
from jezero.base.mistakes import mistake, unknown
from jezero.cli.main import main
from jezero.client.goal_sender import GoalSender, action_named
from jezero.mission_files.problems import MissionFileError
from jezero.mission_files.reader import read_mission
from jezero.schemas.goals import GoToGoal
from jezero.schemas.topics import ACTIONS, GO_TO
from jezero.services.ground_station.goal_form import form_of, goal_from
from jezero.services.mission.service import MissionService
from jezero.services.vehicle_bridge.requests import unknown_action_reply

Fields = dict[str, Any]
TARGET: Fields = {"target_ned_m": [0.0, 0.0, -3.0]}
KNOWN = "target_ned_m, frame, do_takeoff, yaw_rad, speed_mps, override"
UNKNOWN_ACTION = f"there is no action 'goto'; did you mean 'go_to'? Known are {', '.join(ACTIONS)}"
MISTAKES: list[tuple[str, Fields, str]] = [
    ("goto", TARGET, UNKNOWN_ACTION),
    ("go_to", {**TARGET, "sped_mps": 2}, f"there is no field 'sped_mps'; did you mean 'speed_mps'? Known are {KNOWN}"),
    ("go_to", {"yaw_rad": 0.0}, "target_ned_m is missing"),
    ("go_to", {**TARGET, "do_takeoff": "soon"}, "do_takeoff: expected true or false, not a text"),
    ("go_to", {**TARGET, "yaw_rad": 99.0}, "yaw_rad: expected a number from -6.2832 to 6.2832"),
    ("go_to", {**TARGET, "frame": "rovr"}, "frame: there is no value 'rovr'; did you mean 'rover'? Known are"),
]  # fmt: skip


def on_the_command_line(action: str, fields: Fields, folder: Path) -> str:
    words = [f"{name}={msgspec.json.encode(value).decode()}" for name, value in fields.items()]
    done = CliRunner().invoke(main, ["action", "send", action, *words])
    assert done.exit_code == 2
    return done.stderr


def by_the_client(action: str, fields: Fields, folder: Path) -> str:
    connection = SimpleNamespace(vehicle_time_ns=lambda: 1, client_id="me")  # nothing is sent
    with pytest.raises(ValueError) as error:
        GoalSender(cast(Any, connection)).send(action_named(action), None, fields)
    return str(error.value)


def as_a_payload(action: str, fields: Fields, folder: Path) -> str:
    """By plain Zenoh: what the action's server refuses, or the bridge for an action that doesn't exist."""
    refusal = unknown_action_reply(f"@action/{action}", tuple(ACTIONS))
    if refusal is not None:
        return str(cast(Any, refusal).reason)
    with pytest.raises(BadPayloadError) as error:
        decode(ACTIONS[action].goal_type, msgspec.json.encode(fields))
    return str(error.value)


def as_parameters(action: str, fields: Fields, folder: Path) -> str:
    """By plain Zenoh, with the fields as parameters of the selector."""
    if action not in ACTIONS:
        return as_a_payload(action, fields, folder)
    parameters = {name: msgspec.json.encode(value).decode() for name, value in fields.items()}
    with pytest.raises(BadPayloadError) as error:
        decode_request(ACTIONS[action].goal_type, b"", parameters)
    return str(error.value)


def in_a_mission_file(action: str, fields: Fields, folder: Path) -> str:
    file = folder / "mission.yaml"
    file.write_text(f"steps:\n  - {action}: {msgspec.json.encode(fields).decode()}\n")
    with pytest.raises(MissionFileError) as error:
        read_mission(file)
    return str(error.value)


def in_a_mission_of_a_program(action: str, fields: Fields, folder: Path) -> str:
    from jezero.schemas.mission import GoalStep, Mission

    mission = Mission(name="a", steps=(GoalStep(label="fly", action=action, goal=fields),))
    return MissionService(boot_id=1, actions=ACTIONS)._goals_refusal(mission)


DOORS = [on_the_command_line, by_the_client, as_a_payload, as_parameters, in_a_mission_file, in_a_mission_of_a_program]


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.__name__)
@pytest.mark.parametrize(("action", "fields", "sentence"), MISTAKES, ids=[sentence[:30] for _, _, sentence in MISTAKES])
def test_a_mistake_has_one_sentence(
    tmp_path: Path, door: Callable[[str, Fields, Path], str], action: str, fields: Fields, sentence: str
) -> None:
    assert sentence in door(action, fields, tmp_path)


@pytest.mark.parametrize(
    ("typed", "name", "sentence"),
    [
        ({}, "target_ned_m", "target is missing"),
        ({"yaw_rad": "north"}, "yaw_rad", "yaw: expected a number, not a text"),
        ({"yaw_rad": "999"}, "yaw_rad", "yaw: expected a number from -360 to 360"),
    ],
)
def test_the_form_of_the_page_has_it_too_with_labels_and_degrees(typed: Fields, name: str, sentence: str) -> None:
    """Its actions and fields are those of the stack's descriptions, so that none is unknown."""
    assert goal_from(form_of(GO_TO.description.goal)[1], typed)[1][name] == sentence


def test_a_topic_a_setting_and_an_action_of_the_reference_are_named_alike(tmp_path: Path) -> None:
    from jezero.client.subscription import topic_named

    with pytest.raises(ValueError, match=r"there is no topic 'odometri'; did you mean 'odometry'\? Known are clock, "):
        topic_named("odometri")
    done = CliRunner().invoke(main, shlex.split("info actions goto"))
    assert done.exit_code == 2 and UNKNOWN_ACTION in done.stderr


def test_a_long_name_is_cut() -> None:
    assert len(unknown("action", "x" * 5000, ["go_to"])) < 150


def test_a_nested_field_is_named_by_its_path() -> None:
    with pytest.raises(msgspec.ValidationError) as error:
        msgspec.convert({"target_ned_m": [0.0, 1e9, 0.0]}, GoToGoal)
    assert mistake(error.value, GoToGoal) == "target_ned_m[1]: expected a number from -1000000 to 1000000"


def test_a_bound_that_does_not_belong_to_the_range_is_told() -> None:
    from jezero.services.simulator.config import GnssConfig

    with pytest.raises(msgspec.ValidationError) as error:
        msgspec.convert({"rate_hz": 0.0}, GnssConfig)
    assert mistake(error.value, GnssConfig, "setting") == "rate_hz: expected a number above 0 and of at most 250"
