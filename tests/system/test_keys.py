"""A stack whose router listens with keys: members fly or watch by their roles, and strangers do neither."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero import Refused, Unreachable, Vehicle
from jezero.keys.team import Team
from tests.keys.rig import make_team
from tests.system.conftest import Stack, stack_with_keys


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Team:
    return make_team(tmp_path_factory.mktemp("team"))


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory, team: Team) -> Iterator[Stack]:
    with stack_with_keys(tmp_path_factory.mktemp("stack"), team.bundle("vehicle-uav1")) as stack:
        yield stack


def address(stack: Stack) -> str:
    return stack.environment["JEZERO_LISTEN"]


def connect(stack: Stack, bundle: Path | None) -> Vehicle:
    return Vehicle.connect(stack.instance.vehicle, router=address(stack), keys=bundle, timeout_s=5.0)


def test_a_pilot_flies_while_a_viewer_watches(stack: Stack, team: Team) -> None:
    with connect(stack, team.bundle("pilot-ana")) as pilot, connect(stack, team.bundle("viewer-eye")) as viewer:
        pilot.wait_ready()
        for send in (viewer.takeoff, viewer.hover, viewer.abort):
            with pytest.raises(Refused, match="viewer-eye has no right to"):
                send()
        pilot.takeoff(altitude_m=2.0).result(timeout_s=60)
        assert viewer.status().name == "HOVER"
        assert viewer.relative().valid
        pilot.hover()
        pilot.land_on_spot().result(timeout_s=90)
        assert viewer.status().name == "IDLE"


def test_the_commands_on_the_vehicles_own_computer_need_nothing_else(stack: Stack) -> None:
    assert "IDLE" in stack.jezero("status").stdout
    assert "ready" in stack.jezero("ps").stdout


def test_a_stranger_without_keys_does_not_get_in(stack: Stack) -> None:
    with pytest.raises(Unreachable, match="--keys"):
        connect(stack, None)
    with pytest.raises(Unreachable, match="speaks TLS only"):
        Vehicle.connect(stack.instance.vehicle, router=address(stack).replace("tls/", "tcp/"), timeout_s=5.0)
