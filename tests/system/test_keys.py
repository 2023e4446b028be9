"""A stack whose router listens with keys: members fly or watch by their roles, and strangers do neither."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero import Refused, Unreachable, Vehicle
from jezero.keys.team import Team
from tests.keys.rig import make_team
from tests.system.conftest import Stack, stack_with_keys, wait_for


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


@pytest.mark.long
def test_keys_are_renewed_and_revoked_in_flight_and_the_pilots_goal_goes_on(
    stack: Stack, team: Team, tmp_path: Path
) -> None:
    log = stack.run_dir / "logs" / "router.log"

    elsewhere = shutil.copytree(team.bundle("viewer-eye"), tmp_path / "viewer-eye")

    def answer_to_viewer(bundle: Path) -> str:
        with connect(stack, bundle) as viewer:
            try:
                return viewer.status().name
            except Unreachable as error:
                return str(error)

    with connect(stack, team.bundle("pilot-ana")) as pilot, stack.connect() as local:
        pilot.takeoff(altitude_m=2.0).result(timeout_s=60)
        goal = pilot.go_to(8.0, 0.0, -3.0, speed_mps=0.5)
        team.renew("vehicle-uav1")
        wait_for(lambda: "the keys have changed" in log.read_text(), 10.0, "the new certificate")
        team.revoke("viewer-eye")
        wait_for(lambda: "viewer-eye is revoked, or" in answer_to_viewer(elsewhere), 20.0, "revoked")
        assert answer_to_viewer(team.bundle("viewer-eye")).startswith("viewer-eye is revoked: ask the one")
        status = local.status()
        assert (status.name, status.goal_id) == ("GO_TO", goal.goal_id)
        goal.result(timeout_s=60)
        pilot.land_on_spot().result(timeout_s=90)
