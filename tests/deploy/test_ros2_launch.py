"""The launch file starts the bridge with the options that it has. ROS's `launch` is not on PyPI, so that its few names
that the file uses have stand-ins here."""

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import click
import pytest

from jezero.cli.ros2 import bridge
from jezero.services.ros2_bridge.rows import ros_name

FILE = Path(__file__).parents[2] / "deploy" / "ros2" / "jezero_bringup" / "launch" / "bridge.launch.py"
VARIABLES = ("JEZERO_VEHICLE", "JEZERO_ROUTER", "JEZERO_KEYS")


class Argument(NamedTuple):
    """An argument that the launch file declares."""

    name: str
    default_value: str
    description: str
    choices: tuple[str, ...] | list[str] = ()


class Launch(NamedTuple):
    """The launch file, loaded.

    Attributes:
        arguments: that it declares, by their names.
        starts: the functions that make its processes, by their names, from the arguments' values.
    """

    arguments: dict[str, Argument]
    starts: dict[str, Callable[[dict[str, str]], list[Any]]]

    def words(self, process: str, **given: str) -> list[str]:
        """The command of a process, where the user gives some arguments."""
        assert given.keys() <= self.arguments.keys()
        values = {name: argument.default_value for name, argument in self.arguments.items()} | given
        (started,) = self.starts[process](values)
        return list(started.cmd)

    def options(self, **given: str) -> dict[str, Any]:
        """Options that the command of the bridge gets."""
        words = self.words("bridge", **given)
        assert words[:3] == ["jezero", "ros2", "bridge"]
        return options(words[3:])


def options(words: list[str]) -> dict[str, Any]:
    """All options of the bridge, by click's names, from the words after its command."""
    context = bridge.make_context("bridge", words)
    return {**context.params, **{name: context.meta.get(f"jezero.{name}") for name in ("keys", "insecure")}}


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Callable[[], Launch]:
    """Load the launch file."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    names: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": lambda entities: entities},
        "launch.actions": {
            "DeclareLaunchArgument": Argument,
            "ExecuteProcess": SimpleNamespace,
            "OpaqueFunction": SimpleNamespace,
        },
        "launch.conditions": {"IfCondition": lambda value: value},
        "launch.substitutions": {
            "LaunchConfiguration": lambda name: SimpleNamespace(perform=lambda values: values[name])
        },
    }
    for module, content in names.items():
        stand_in = ModuleType(module)
        stand_in.__dict__.update(content)
        monkeypatch.setitem(sys.modules, module, stand_in)

    def loaded() -> Launch:
        entities = runpy.run_path(str(FILE))["generate_launch_description"]()
        arguments = {each.name: each for each in entities if isinstance(each, Argument)}
        functions = [each.function for each in entities if not isinstance(each, Argument)]
        return Launch(arguments, {function.__name__: function for function in functions})

    return loaded


def test_each_option_of_the_bridge_is_an_argument_and_each_argument_is_one(load: Callable[[], Launch]) -> None:
    assert isinstance(bridge, click.Command)
    known = {option.name for option in bridge.params}
    assert load().arguments.keys() - {"rviz"} == known


def test_arguments_have_the_defaults_of_the_bridge(load: Callable[[], Launch]) -> None:
    launch = load()
    assert launch.options() == options([])
    for name, value in options([]).items():
        if launch.arguments[name].choices:
            assert launch.arguments[name].default_value == ("true" if value else "false")


@pytest.mark.parametrize(
    ("name", "value", "option"),
    [
        ("vehicle", "uav2", "uav2"),
        ("router", "tcp/127.0.0.1:7001", "tcp/127.0.0.1:7001"),
        ("rover_odometry", "/odom", "/odom"),
        ("rover_cmd_vel", "/cmd_vel", "/cmd_vel"),
        ("rover_driver", "127.0.0.1:9002", ("127.0.0.1", 9002)),
        ("rover_heading", "-12.5", -12.5),
        ("commands", "true", True),
        ("clock", "false", False),
        ("insecure", "true", True),
    ],
)
def test_an_argument_becomes_its_option(load: Callable[[], Launch], name: str, value: str, option: Any) -> None:
    assert load().options(**{name: value}) == options([]) | {name: option}


def test_the_folder_of_the_keys_becomes_its_option(load: Callable[[], Launch], tmp_path: Path) -> None:
    assert load().options(keys=str(tmp_path))["keys"] == tmp_path


def test_a_flag_is_true_or_false_and_nothing_else(load: Callable[[], Launch]) -> None:
    flags = {name for name, each in load().arguments.items() if each.default_value in ("true", "false")}
    assert flags == {name for name, each in load().arguments.items() if list(each.choices) == ["true", "false"]}
    assert flags == {"commands", "clock", "insecure", "rviz"}


def test_variables_of_the_environment_are_defaults(load: Callable[[], Launch], monkeypatch: pytest.MonkeyPatch) -> None:
    values = ("uav7", "tcp/127.0.0.1:7002", "/keys")
    for name, value in zip(VARIABLES, values, strict=True):
        monkeypatch.setenv(name, value)
    arguments = load().arguments
    assert tuple(arguments[name].default_value for name in ("vehicle", "router", "keys")) == values


@pytest.mark.parametrize("vehicle", ["uav2", "my-uav.1", "7", "\N{LATIN SMALL LETTER U WITH DIAERESIS}av"])
def test_rviz_has_the_names_of_the_vehicle(load: Callable[[], Launch], vehicle: str) -> None:
    words = load().words("rviz", vehicle=vehicle)
    assert words[:2] == ["rviz2", "-d"]
    layout = Path(words[2]).read_text()
    assert f"Value: /{ros_name(vehicle)}/odometry\n" in layout
    assert f"Fixed Frame: {ros_name(vehicle)}/map\n" in layout
    assert "uav1" not in layout
