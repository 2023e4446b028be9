"""A page that may not fly reaches the vehicle by none of its commands."""

import asyncio
import inspect
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from nicegui import ui

from jezero.schemas.topics import GO_TO
from jezero.services.ground_station.state import ShownState
from jezero.services.ground_station.web.commands import Commands

EXAMPLES: dict[str, Any] = {
    "str": "takeoff",
    "float": 0.0,
    "collections.abc.Mapping[str, typing.Any]": {"words": "go to", "action": "go_to", "goal_id": "1"},
    "jezero.schemas.rows.Action[typing.Any]": GO_TO,
    "collections.abc.Callable[[jezero.aio.vehicle.Vehicle], "
    "collections.abc.Awaitable[jezero.schemas.simulator.SimulatorState]]": lambda uav: uav.simulator.pause(),
}
"""An argument of each type that commands have."""


class UntouchedVehicle:
    """A vehicle that must not be asked for anything."""

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"{name} was asked for")


class OneVehicle:
    """A feed with a vehicle."""

    def __init__(self) -> None:
        self.state = ShownState()
        self.uav, self.vehicle, self.problem = UntouchedVehicle(), "uav1", ""


def _all_commands() -> Iterator[tuple[str, list[Any]]]:
    for name, function in inspect.getmembers(Commands, inspect.iscoroutinefunction):
        parameters = list(inspect.signature(function).parameters.values())[1:]
        needed = [parameter for parameter in parameters if parameter.default is inspect.Parameter.empty]
        if not name.startswith("_"):
            yield name, [EXAMPLES[_name_of(parameter.annotation)] for parameter in needed]


def _name_of(annotation: Any) -> str:
    return annotation.__name__ if annotation in (str, float) else str(annotation)


@pytest.mark.parametrize(("name", "arguments"), list(_all_commands()))
def test_no_command_of_a_page_that_watches_reaches_the_vehicle(
    name: str, arguments: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    monkeypatch.setattr(ui, "notify", lambda text, **rest: told.append(text))
    feed: Any = OneVehicle()
    reply = asyncio.run(getattr(Commands(feed, lambda: "you are watching"), name)(*arguments))
    assert "you are watching" in f"{reply} {told}"


def test_a_page_that_may_fly_reaches_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ui, "notify", lambda text, **rest: None)
    feed: Any = OneVehicle()
    with pytest.raises(AssertionError, match="hover was asked for"):
        asyncio.run(Commands(feed, lambda: "").hover())


def test_a_drive_ends_with_the_log_in_also_while_the_wheel_is_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(ui, "notify", lambda text, **rest: told.append(text))
    feed: Any = OneVehicle()
    driving = Commands(feed, lambda: "you are watching")
    driving._drives = True
    driving._wheel.turn(0.5, 0.0)
    asyncio.run(driving.steer(0.5, 0.0))
    assert told == ["Driving the rover failed: you are watching"]
