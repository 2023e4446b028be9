"""`jezero info page`, and the words of the reference pages."""

import re
import shlex
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import click
import msgspec
import pytest
from click.testing import CliRunner
from msgspec import Meta
from msgspec.structs import replace

from jezero.base.codec import decode_request
from jezero.cli.info import PAGES, reference_page
from jezero.cli.main import main
from jezero.cli.reference.actions import EXAMPLES
from jezero.cli.reference.words import Field, attributes_of, description_of, fields_of, summary_of, table, unit_of
from jezero.client.vehicle import Vehicle
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action
from jezero.schemas.state import Odometry, Status, StatusCode
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan
from jezero.services.actions.table import PLANNERS

ROOT = Path(__file__).parents[2]


class Inner(msgspec.Struct):
    """One corner."""

    x_m: float


class Base(msgspec.Struct, kw_only=True):
    """What all have.

    Attributes:
        name: who it is.
    """

    name: Annotated[str, Meta(max_length=8)] = ""


class Example(Base, kw_only=True):
    """An example of every kind.

    Attributes:
        speed_mps: speed along the path, which is
            described on two lines.
        low, high: bounds.

    Raises:
        ValueError: never: this is no field.
    """

    speed_mps: Annotated[float, Meta(gt=0.0, le=10.0)] = 2.0
    low: Annotated[int, Meta(ge=1, le=5)]
    high: int | None = None
    path_ned_m: tuple[tuple[float, float, float], ...] = ()
    mode: Literal["slow", "fast"] = "slow"
    corners: tuple[Inner, ...] = ()
    far_m: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0


class Long(msgspec.Struct):
    """A path.

    It begins at the start
    and ends at the target.

    Attributes:
        length_m: length of the path.
    """

    length_m: float


class Short(msgspec.Struct):
    """altitude_m: above the ground; speed_mps: along the path."""

    altitude_m: float
    speed_mps: float


def field(name: str) -> Field:
    return next(field for field in fields_of(Example) if field.name == name)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_printed(name: str) -> None:
    result = CliRunner().invoke(main, ["info", "page", name])
    assert result.exit_code == 0
    assert result.output.startswith("# ")


@pytest.mark.parametrize("name", ["actions", "settings"])
def test_every_field_on_a_page_has_a_meaning(name: str) -> None:
    rows = [line for line in reference_page(name).splitlines() if line.startswith("| `")]
    assert rows
    assert [row for row in rows if row.endswith("|  |")] == []


def test_a_page_without_a_name_names_the_pages() -> None:
    result = CliRunner().invoke(main, ["info", "page"])
    assert result.exit_code == 2
    assert all(name in result.output for name in PAGES)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("radius_m", "m"),
        ("yaw_rate_rps", "rad/s"),
        ("cone_per_m", "per m"),
        ("gain_1ps", "1/s"),
        ("tries", ""),
        ("s", ""),
    ],
)
def test_a_unit_is_the_end_of_a_name(name: str, unit: str) -> None:
    assert unit_of(name) == unit


@pytest.mark.parametrize(
    ("name", "value", "limits", "default"),
    [
        ("name", "text", "≤ 8 characters", '`""`'),
        ("speed_mps", "number, m/s", "> 0, ≤ 10", "`2.0`"),
        ("low", "whole number", "1 … 5", "required"),
        ("high", "whole number", "", "none"),
        ("path_ned_m", "n × 3 numbers, m", "", "`[]`"),
        ("mode", "`fast` or `slow`", "", '`"slow"`'),
        ("corners", "list of [Inner](#inner)", "", "`[]`"),
        ("far_m", "number, m", "", "`0.0`"),
    ],
)
def test_a_field_has_words_for_people(name: str, value: str, limits: str, default: str) -> None:
    found = field(name)
    assert (found.value, found.range, found.default) == (value, limits, default)


def test_meanings_come_from_docstrings_of_the_struct_and_its_bases() -> None:
    assert attributes_of(Example) == {
        "name": "who it is.",
        "speed_mps": "speed along the path, which is described on two lines.",
        "low": "bounds.",
        "high": "bounds.",
    }
    assert summary_of(Example) == "An example of every kind."


def test_a_description_has_all_paragraphs_but_those_of_fields_and_exceptions() -> None:
    assert description_of(Long) == "A path.\n\nIt begins at the start and ends at the target."
    assert description_of(Inner) == "One corner."
    assert description_of(Short) == ""


def test_a_docstring_may_hold_descriptions_of_fields_only() -> None:
    assert attributes_of(Short) == {"altitude_m": "above the ground", "speed_mps": "along the path."}
    assert summary_of(Short) == ""


def test_a_cell_keeps_its_bars_and_brackets() -> None:
    assert table([{"a": "x|y <z>", "b": "`<z>`"}]).splitlines()[-1] == "| x\\|y &lt;z> | `<z>` |"


def test_every_action_has_an_example() -> None:
    assert set(EXAMPLES) == set(ACTIONS)


@pytest.mark.parametrize("name", ACTIONS)
def test_an_example_of_a_command_is_parsed(name: str) -> None:
    _, command, *words = shlex.split(EXAMPLES[name].command)
    words = [word for word in words if word != "field.kml"]
    words = [word for word in words if word != "--polygon"]
    with click.Context(main) as context:
        found = main.get_command(context, command)
    assert found is not None
    found.make_context(command, words)


class GoalSenderSpy:
    """Keeps the goals that a vehicle's methods send."""

    def __init__(self) -> None:
        self.sent: list[Goal] = []

    def send(self, action: Action[Any], goal: Goal) -> None:
        assert type(goal) is action.goal_type
        self.sent.append(goal)

    send_for_images = send


@pytest.mark.parametrize("name", ACTIONS)
def test_an_example_of_a_call_sends_the_goal(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spy, connection = GoalSenderSpy(), cast("Any", None)
    monkeypatch.setattr("jezero.client.vehicle.GoalSender", lambda _: spy)
    eval(EXAMPLES[name].call, {"uav": Vehicle(connection)})
    assert [replace(goal, goal_id="") for goal in spy.sent] == [EXAMPLES[name].goal]


SELECTORS = re.findall(r"jezero/uav1/@action/(\w+)(?:\?([^`'\s]*))?[`']", reference_page("actions"))
"""Action and parameters of every selector on the page of all actions that sends a goal."""


def test_the_page_has_a_selector_of_each_action() -> None:
    assert {name for name, _ in SELECTORS} == set(ACTIONS)


@pytest.mark.parametrize(("name", "parameters"), SELECTORS)
def test_a_selector_on_the_page_is_decoded_and_planned(name: str, parameters: str) -> None:
    """As when it is copied: the fields are parameters, separated by `;`."""
    action, words = ACTIONS[name], dict(word.split("=", 1) for word in parameters.split(";") if word)
    goal = decode_request(action.goal_type, b"", words, needs_field=action.endpoint.needs_field)
    expected = EXAMPLES[name].goal if "_time" not in words else goal
    assert goal == expected
    planner = PLANNERS[name](ActionsConfig())
    code = StatusCode.IDLE if name == "takeoff" else StatusCode.HOVER
    assert isinstance(planner.plan(goal, hovering(code)), Plan)


def hovering(code: StatusCode) -> Status:
    """Status of a vehicle 3 m above the origin, or on the ground there."""
    landed = code is StatusCode.IDLE
    odometry = Odometry(
        t_ns=0,
        epoch_id=1,
        pos_uav_ned_m=(0.0, 0.0, 0.0 if landed else -3.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
    )
    return Status(
        t_ns=0,
        code=code,
        name=code.name,
        odometry=odometry,
        armed=not landed,
        landed=landed,
        in_charge="none" if landed else "hover",
        bridge_boot_id=1,
        ready=True,
        takeoff_ned_m=(0.0, 0.0, 0.0),
    )


@pytest.mark.parametrize("name", ACTIONS)
def test_an_example_of_a_goal_has_values_in_range(name: str) -> None:
    goal = EXAMPLES[name].goal
    assert type(goal) is ACTIONS[name].goal_type
    assert msgspec.json.decode(msgspec.json.encode(goal), type=type(goal)) == goal


def test_the_fields_of_a_goal_are_shown_with_unit_range_and_default() -> None:
    shown = CliRunner().invoke(main, ["info", "actions", "takeoff"]).output
    assert "@action/takeoff" in shown
    assert "altitude_m" in shown and "number, m" in shown


@pytest.mark.parametrize("name", ACTIONS)
def test_the_json_schema_of_a_goal_accepts_exactly_its_fields(name: str) -> None:
    shown = CliRunner().invoke(main, ["info", "actions", name, "--json"]).output
    schema = msgspec.json.decode(shown)["goal"]
    goal = schema["$defs"][schema["$ref"].rsplit("/", 1)[1]]
    assert set(goal["properties"]) == set(ACTIONS[name].goal_type.__struct_fields__)
    assert goal["additionalProperties"] is False


def test_an_action_that_does_not_exist_is_answered_with_those_that_do() -> None:
    result = CliRunner().invoke(main, ["info", "actions", "takof"])
    assert result.exit_code == 2
    assert "takeoff" in result.output and "land_on_spot" in result.output


def test_every_environment_variable_of_the_code_is_on_the_page_of_settings_and_in_the_how_to() -> None:
    folders = (ROOT / name for name in ("jezero", "services", "schemas", "deploy", "benchmarks"))
    files = [path for folder in folders for path in folder.rglob("*") if path.suffix in (".py", ".yaml", ".toml")]
    own = re.compile(r"(?<!_)JEZERO_[A-Z0-9_]*[A-Z0-9]")  # click's `_JEZERO_COMPLETE` is none
    used = {name for path in files for name in own.findall(path.read_text())}
    page = reference_page("settings").partition("## Environment")[2]
    how_to = (ROOT / "docs" / "how-to" / "configure.md").read_text()
    for text in (page, how_to):
        assert set(re.findall(r"^\| `(JEZERO_\w+)` \|", text, re.MULTILINE)) == used


def test_the_how_to_names_the_defaults_of_the_environment_variables() -> None:
    how_to = (ROOT / "docs" / "how-to" / "configure.md").read_text()
    defaults = dict(re.findall(r"^\| `(JEZERO_\w+)` \| (.+?) \|", how_to, re.MULTILINE))
    for row in re.findall(r"^\| `JEZERO_.*$", reference_page("settings"), re.MULTILINE):
        name, _, _, default = (cell.strip().replace('"', "") for cell in row.split("|")[1:5])
        assert defaults[name.strip("`")] == default


def test_no_cell_of_the_settings_is_too_long_to_read() -> None:
    cells = [
        cell for line in reference_page("settings").splitlines() if line.startswith("|") for cell in line.split(" | ")
    ]
    assert len(cells) > 500
    assert max(map(len, cells)) < 400
