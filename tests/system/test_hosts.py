"""Computers with routers of their own, linked by bad radios: what flies, and what happens when a link is cut."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from jezero.keys.team import Team
from jezero.runtime.config import Instance
from tests.system.conftest import JEZERO, Stack, wait_for
from tests.system.radio import Network, Radio, missing

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing()), pytest.mark.long]

BAD_RADIO = Radio(rate_bps=1e6, delay_s=0.05, loss=0.05)
PORT = 7448
RADIO = ("vehicle", "ground")
COMMAND_S = 60.0


@dataclass
class Hosts:
    """A vehicle's computer and one on the ground.

    Attributes:
        network: their namespaces, and the radio between them.
        vehicle, ground: the part of the stack on each.
    """

    network: Network
    vehicle: Stack
    ground: Stack

    def status(self, stack: Stack) -> dict[str, object]:
        """The status as a computer sees it."""
        found: dict[str, object] = json.loads(stack.jezero("status", "--json").stdout)
        return found


def stack_on(network: Network, computer: str, folder: Path, bundle: Path, **variables: str) -> Stack:
    environment = {
        **os.environ,
        "JEZERO_VEHICLE": "uav1",
        "JEZERO_RUN_DIR": str(folder / computer),
        "JEZERO_KEYS": str(bundle),
        **variables,
    }
    return Stack(Instance(), folder / computer, environment, before=tuple(network.words(computer)))


@pytest.fixture(scope="module")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    folder = tmp_path_factory.mktemp("hosts")
    team = Team(folder / "team")
    team.found()
    with Network(RADIO) as network:
        address, _ = network.add_link(*RADIO, BAD_RADIO)
        network.start()
        team.add("vehicle", "uav1", [address])
        team.add("ground", "lab")
        listen, connect = {"JEZERO_LISTEN": f"tls/0.0.0.0:{PORT}"}, {"JEZERO_CONNECT": f"tls/{address}:{PORT}"}
        vehicle = stack_on(network, "vehicle", folder, team.bundle("vehicle-uav1"), **listen)
        ground = stack_on(network, "ground", folder, team.bundle("ground-lab"), **connect)
        try:
            yield Hosts(
                network, vehicle.up("--profile", "onboard", "--profile", "sim"), ground.up("--profile", "ground")
            )
        finally:
            for stack in (ground, vehicle):
                stack.jezero("down", check=False)


@pytest.fixture
def on_ground(hosts: Hosts) -> Iterator[Hosts]:
    """The hosts with the vehicle on the ground, before and after."""
    assert hosts.status(hosts.vehicle)["landed"] is True
    yield hosts
    if not hosts.status(hosts.vehicle)["landed"]:
        hosts.vehicle.jezero("land_on_spot")


def test_a_flight_is_commanded_over_a_bad_radio_while_a_viewer_watches(on_ground: Hosts) -> None:
    with subprocess.Popen(
        [*on_ground.ground.before, *JEZERO, "status", "--watch"], env=on_ground.ground.environment,
        stdout=subprocess.PIPE, text=True,
    ) as viewer:  # fmt: skip
        try:
            on_ground.ground.jezero("takeoff", "3")
            begin_s, before = time.monotonic(), on_ground.network.carried_bytes(*RADIO)
            on_ground.ground.jezero("target", "4", "0", "-3")
            carried_bps = 8 * (on_ground.network.carried_bytes(*RADIO) - before) / (time.monotonic() - begin_s)
            on_ground.ground.jezero("land_on_spot")
        finally:
            viewer.terminate()
        seen = viewer.communicate()[0]
    assert on_ground.status(on_ground.vehicle)["landed"] is True
    assert all(word in seen for word in ("TAKEOFF", "GO_TO", "LANDING"))
    print(f"the radio carried {carried_bps / 1e3:.0f} kbit/s")


def test_the_vehicle_flies_on_while_the_ground_is_gone_and_the_ground_finds_it_again(on_ground: Hosts) -> None:
    on_ground.vehicle.jezero("takeoff", "3")
    sender = on_ground.ground.start("target", "25", "0", "-3", "--speed", "1")
    wait_for(lambda: on_ground.status(on_ground.vehicle)["name"] == "GO_TO", COMMAND_S, "the goal is flown")
    with on_ground.network.cut(*RADIO):
        _, complaint = sender.communicate(timeout=COMMAND_S)
        assert sender.returncode != 0 and complaint
        assert on_ground.status(on_ground.vehicle)["name"] == "GO_TO"
        health = on_ground.ground.jezero("ps", check=False).stdout
        assert "no link to tls/" in health
    wait_for(lambda: "no link to" not in on_ground.ground.jezero("ps").stdout, COMMAND_S, "the link is there again")
    assert on_ground.ground.jezero("abort").returncode == 0
    assert on_ground.status(on_ground.ground)["name"] == "HOVER"


def test_the_camera_and_setpoints_do_not_cross_the_radio(hosts: Hosts) -> None:
    program = (
        "import time, zenoh\nfrom jezero.zenoh_client import client_config\n"
        "session, heard = zenoh.open(client_config('tcp/127.0.0.1:7447', 5)), set()\n"
        "s = session.declare_subscriber('jezero/uav1/**', lambda each: heard.add(str(each.key_expr)))\n"
        "time.sleep(4)\nprint(*heard)\nsession.close()"
    )
    heard = subprocess.run(
        [*hosts.ground.before, sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env=hosts.ground.environment,
    ).stdout  # fmt: skip
    assert "jezero/uav1/odometry" in heard and "jezero/uav1/camera/info" in heard
    assert "sensor/camera" not in heard and "command/setpoint" not in heard
