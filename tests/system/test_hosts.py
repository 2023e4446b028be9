"""Computers with routers of their own, linked by bad radios: what flies, and what happens when a link is cut."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from jezero.base.config import config_directory
from jezero.keys.team import Team
from jezero.runtime.instance import Instance
from tests.system.conftest import Stack, wait_for
from tests.system.radio import CABLE, Network, Radio, missing

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing()), pytest.mark.long]

BAD_RADIO = Radio(rate_bps=1e6, delay_s=0.05, loss=0.05)
PORT = 7448
RADIO, ROVER_RADIO = ("vehicle", "ground"), ("vehicle", "rover")
LAND_S = 120.0
COMMAND_S = 60.0
MISSION_S = 600.0
ON_ROVER_MAX_M = 0.5


@dataclass
class Hosts:
    """The computers of a vehicle, a rover, and the people on the ground.

    Attributes:
        network: their namespaces, and the radios between them.
        vehicle, rover, ground: the part of the stack on each.
    """

    network: Network
    vehicle: Stack
    rover: Stack
    ground: Stack

    def status(self, stack: Stack) -> dict[str, Any]:
        """The status as a computer sees it."""
        found: dict[str, Any] = json.loads(stack.jezero("status", "--json").stdout)
        return found

    def carried_bytes(self) -> dict[tuple[str, str], int]:
        """Bytes that each radio has carried so far."""
        return {radio: self.network.carried_bytes(*radio) for radio in (RADIO, ROVER_RADIO)}


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
    with Network(("vehicle", "rover", "ground")) as network:
        for_ground, grounds = network.add_link(*RADIO, BAD_RADIO)
        for_rover, _ = network.add_link(*ROVER_RADIO, BAD_RADIO)
        # What the rover's wheels measure comes from the simulator, which runs on the vehicle's computer.
        simulator, _ = network.add_link("vehicle", "rover", CABLE)
        network.start()
        team.add("vehicle", "uav1", [for_ground, for_rover])
        team.add("rover", "r1")
        team.add("ground", "lab")
        world = {"JEZERO_INSECURE": "1"}
        settings = Path(shutil.copytree(config_directory(), folder / "config"))
        (settings / "vehicle.toml").write_text("[camera]\nrate_hz = 5.0\n")  # pictures cost processor time
        file = settings / "simulator.toml"
        file.write_text(f'rover_host = "{simulator}"\n{file.read_text()}')
        members = {
            "vehicle": stack_on(
                network,
                "vehicle",
                folder,
                team.bundle("vehicle-uav1"),
                JEZERO_LISTEN=f"tls/0.0.0.0:{PORT}",
                JEZERO_CONFIG_DIR=str(settings),
                JEZERO_GCS_HOST=grounds,
                **world,
            ),
            "rover": stack_on(
                network,
                "rover",
                folder,
                team.bundle("rover-r1"),
                JEZERO_CONNECT=f"tls/{for_rover}:{PORT}",
                JEZERO_SIMULATOR=simulator,
                **world,
            ),
            "ground": stack_on(
                network, "ground", folder, team.bundle("ground-lab"), JEZERO_CONNECT=f"tls/{for_ground}:{PORT}"
            ),
        }
        try:
            members["vehicle"].up("--profile", "onboard", "--profile", "sim")
            members["rover"].up("--profile", "rover")
            members["ground"].up("--profile", "ground")
            yield Hosts(network, **members)
        finally:
            for stack in reversed(members.values()):
                stack.jezero("down", check=False)


@pytest.fixture
def on_ground(hosts: Hosts) -> Iterator[Hosts]:
    """The hosts with the vehicle on the ground, before and after."""
    assert hosts.status(hosts.vehicle)["landed"] is True
    yield hosts
    if not hosts.status(hosts.vehicle)["landed"]:
        hosts.vehicle.jezero("abort")
        # The vehicle may be about to fly home by itself: then this goal is refused, and it lands all the same.
        wait_for(
            lambda: hosts.vehicle.jezero("return", check=False).returncode == 0 or is_down(hosts), LAND_S, "landed"
        )


def is_down(hosts: Hosts) -> bool:
    return hosts.status(hosts.vehicle)["landed"] is True


@contextmanager
def viewer(hosts: Hosts) -> Iterator[list[str]]:
    """Somebody on the ground who watches the status; the list has the lines at the end of the `with` block."""
    seen: list[str] = []
    watching = hosts.ground.start("status", "--watch")
    try:
        yield seen
    finally:
        watching.terminate()
        seen.extend(watching.communicate(timeout=COMMAND_S)[0].splitlines())


def test_a_flight_is_commanded_over_a_bad_radio_while_a_viewer_watches(on_ground: Hosts) -> None:
    with viewer(on_ground) as seen:
        on_ground.ground.jezero("takeoff", "3")
        begin_s, before = time.monotonic(), on_ground.carried_bytes()
        on_ground.ground.jezero("target", "4", "0", "-3")
        elapsed_s, carried = time.monotonic() - begin_s, on_ground.carried_bytes()
        on_ground.ground.jezero("land_on_spot")
    assert on_ground.status(on_ground.vehicle)["landed"] is True
    assert distance_from_rover_m(on_ground) < ON_ROVER_MAX_M
    assert all(word in "".join(seen) for word in ("TAKEOFF", "GO_TO", "LANDING"))
    for (radio, size), (_, size_before) in zip(carried.items(), before.items(), strict=True):
        print(f"{'–'.join(radio)}: {8e-3 * (size - size_before) / elapsed_s:.0f} kbit/s")


@pytest.mark.slow
def test_the_thesis_mission_is_flown_from_the_ground_over_bad_radios_while_a_viewer_watches(on_ground: Hosts) -> None:
    mission = config_directory().parent / "missions" / "demonstration.yaml"
    with viewer(on_ground) as seen:
        done = on_ground.ground.jezero("mission", "run", "--yes", str(mission), timeout_s=MISSION_S)
    print(done.stdout)
    status = on_ground.status(on_ground.ground)
    assert (status["name"], status["landed"]) == ("IDLE", True), status["text"]
    assert distance_from_rover_m(on_ground) < ON_ROVER_MAX_M
    assert all(word in "".join(seen) for word in ("TAKEOFF", "GET_IMAGES", "COVERAGE", "LANDING"))


def test_pictures_cross_a_bad_radio_one_after_the_other_and_the_goal_goes_on(on_ground: Hosts, tmp_path: Path) -> None:
    on_ground.vehicle.jezero("takeoff", "3")
    words = ("getimages", "4", "0", "-3", "3", "2", "--out", str(tmp_path))
    on_ground.ground.jezero(*words, timeout_s=180)
    assert len(list(tmp_path.rglob("*.jpg"))) == 2
    assert "no link to" not in on_ground.ground.jezero("ps").stdout


def test_the_vehicle_flies_on_while_the_ground_is_gone_and_the_ground_finds_it_again(on_ground: Hosts) -> None:
    on_ground.vehicle.jezero("takeoff", "3")
    sender = on_ground.ground.start("target", "25", "0", "-3", "--speed", "1")
    wait_for(lambda: on_ground.status(on_ground.vehicle)["name"] == "GO_TO", COMMAND_S, "the goal is flown")
    with on_ground.network.cut(*RADIO):
        _, complaint = sender.communicate(timeout=COMMAND_S)
        assert sender.returncode != 0 and complaint
        assert on_ground.status(on_ground.vehicle)["name"] == "GO_TO"
        wait_for(lambda: "no link to tls/" in on_ground.ground.jezero("ps", check=False).stdout, COMMAND_S, "the loss")
    wait_for(lambda: "no link to" not in on_ground.ground.jezero("ps").stdout, COMMAND_S, "the link is there again")
    assert on_ground.ground.jezero("abort").returncode == 0
    assert on_ground.status(on_ground.ground)["name"] == "HOVER"


def test_the_vehicles_router_names_the_members_that_are_connected(hosts: Hosts) -> None:
    wait_for(lambda: "with ground-lab, rover-r1" in hosts.vehicle.jezero("ps").stdout, COMMAND_S, "both members")


def test_the_camera_and_setpoints_do_not_cross_the_radio(hosts: Hosts) -> None:
    program = (
        "import time, zenoh\nfrom jezero.base.zenoh_client import client_config\n"
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


GROUND_STATION = """
import hashlib, sys, time
from pathlib import Path
from pymavlink import mavutil
m, key = mavutil.mavlink, hashlib.sha256(Path(sys.argv[1]).read_bytes().strip()).digest()
link = mavutil.mavlink_connection("udpin:0.0.0.0:14550", source_system=255, dialect="common")
assert link.wait_heartbeat(timeout=10), "no heartbeat"
def answer():
    command = m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES
    for _ in range(20):
        link.mav.command_long_send(1, 1, command, 0, 1, 0, 0, 0, 0, 0, 0)
        ack = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5)
        if ack is not None and ack.command == command:
            return ack.result
print(answer())
link.setup_signing(key)
print(answer())
"""
"""Prints what a vehicle answers to a command, first without a signature, then with that of the team."""


def test_a_mavlink_ground_station_on_the_ground_needs_the_teams_signature(hosts: Hosts) -> None:
    text = Path(hosts.ground.environment["JEZERO_KEYS"]) / "mavlink.key"
    words = [*hosts.ground.before, sys.executable, "-c", GROUND_STATION, str(text)]
    done = subprocess.run(
        words, env={**os.environ, "MAVLINK20": "1"}, capture_output=True, text=True, timeout=90, check=False
    )
    assert done.stdout.split() == ["None", "0"], done.stderr
    assert "messages without a valid signature" in hosts.vehicle.jezero("ps").stdout


WATCH = """
import json, sys, time, zenoh
from jezero.base.zenoh_client import client_config
session, phases = zenoh.open(client_config("tcp/127.0.0.1:7447", 5)), [""]
def on_feedback(sample):
    phase = json.loads(sample.payload.to_bytes())["feedback"]["phase"]
    if phase != phases[-1]:
        phases.append(phase)
        print(phase, flush=True)
kept = session.declare_subscriber("jezero/uav1/action/land_on_spot/feedback", on_feedback)
sys.stdin.read()
session.close()
"""
"""Prints each phase of a landing."""

TRUTH = """
import zenoh
from jezero.base.zenoh_client import client_config
with zenoh.open(client_config("tcp/127.0.0.1:7447", 5)) as session:
    print(session.declare_subscriber("jezero/uav1/truth").recv().payload.to_string())
"""
"""Prints the truth as it is now."""


def distance_from_rover_m(hosts: Hosts) -> float:
    """True horizontal distance of the vehicle from the platform's middle."""
    words = [*hosts.vehicle.before, sys.executable, "-c", TRUTH]
    done = subprocess.run(words, env=hosts.vehicle.environment, capture_output=True, text=True, check=True, timeout=30)
    truth = json.loads(done.stdout)
    north_m, east_m, _ = (a - b for a, b in zip(truth["pos_uav_ned_m"], truth["pos_rover_ned_m"], strict=True))
    return hypot(north_m, east_m)


class Landing:
    """A landing that the ground asks for, observed on the vehicle's computer.

    Args:
        hosts: the computers; the vehicle flies.
    """

    def __init__(self, hosts: Hosts) -> None:
        self._hosts = hosts
        self._watch = subprocess.Popen(
            [*hosts.vehicle.before, sys.executable, "-c", WATCH], env=hosts.vehicle.environment,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        time.sleep(2.0)
        self._sender = hosts.ground.start("land_on_spot")

    def wait_for_phase(self, phase: str) -> None:
        for line in self._watch.stdout or ():
            if line.strip() == phase:
                return
        raise AssertionError(f"the phase {phase} did not come")

    def end(self) -> tuple[dict[str, Any], float, str]:
        """Wait for the end; returns the status, the true distance from the platform's middle, and what the ground saw.

        Raises:
            AssertionError: the landing goes on for four minutes.
        """

        def ended() -> bool:
            return self._hosts.status(self._hosts.vehicle)["name"] in ("IDLE", "HOVER", "FAILSAFE")

        wait_for(ended, 240, "the landing's end")
        out, err = self._sender.communicate(timeout=90)
        self._watch.communicate("")
        status, distance_m = self._hosts.status(self._hosts.vehicle), distance_from_rover_m(self._hosts)
        return status, distance_m, (err or out).strip().splitlines()[-1]


def cut_a_landing(hosts: Hosts, radio: tuple[str, str], phase: str, cut_s: float) -> tuple[dict[str, Any], float, str]:
    """Take off beside the rover, land on it, and cut a radio when a phase begins; see `Landing.end`."""
    hosts.vehicle.jezero("takeoff", "3")
    hosts.vehicle.jezero("target", "8", "4", "-5")
    landing = Landing(hosts)
    landing.wait_for_phase(phase)
    with hosts.network.cut(*radio):
        time.sleep(cut_s)
    return landing.end()


@pytest.mark.parametrize(
    ("radio", "phase"),
    [
        pytest.param(RADIO, "descent", marks=pytest.mark.slow),
        pytest.param(ROVER_RADIO, "approach", marks=pytest.mark.slow),
        (ROVER_RADIO, "descent"),
    ],
)
def test_a_landing_goes_on_while_a_radio_is_cut_for_three_seconds(
    on_ground: Hosts, radio: tuple[str, str], phase: str
) -> None:
    status, distance_m, _ = cut_a_landing(on_ground, radio, phase, 3.0)
    assert status["landed"] is True and distance_m < ON_ROVER_MAX_M, status["text"]


@pytest.fixture
def driving(on_ground: Hosts) -> Iterator[Hosts]:
    """The hosts while a program on the rover's computer drives it in a circle, for as long as it hears the clock."""
    driver = on_ground.rover.start("rover", "drive", "0.3", "0.1")
    yield on_ground
    driver.terminate()
    _, complaint = driver.communicate(timeout=COMMAND_S)
    assert driver.returncode == -signal.SIGTERM or "no clock" in complaint, complaint


RADIOS = pytest.mark.parametrize("radio", [RADIO, ROVER_RADIO], ids=["vehicle-ground", "vehicle-rover"])
PHASES = pytest.mark.parametrize("phase", ["approach", "descent"])


def check_end(hosts: Hosts, radio: tuple[str, str], phase: str, cut_s: float) -> None:
    """Land with a radio cut, print a row of the table of docs/reliability.md, and check how the landing ended."""
    status, distance_m, seen = cut_a_landing(hosts, radio, phase, cut_s)
    print(
        f"| {'–'.join(radio)} | {phase} | {cut_s:g} | {status['name']}, {distance_m:.2f} m from the platform's middle "
        f"| {status['text']} | {seen} |"
    )
    on_rover = status["landed"] is True and distance_m < ON_ROVER_MAX_M
    assert on_rover or (status["name"] == "HOVER" and status["text"]), status


@pytest.mark.slow
@pytest.mark.parametrize("cut_s", [3.0, 15.0, 60.0])
@PHASES
@RADIOS
def test_a_landing_whose_radio_is_cut_ends_on_the_rover_or_in_a_hover_that_says_why(
    on_ground: Hosts, radio: tuple[str, str], phase: str, cut_s: float
) -> None:
    check_end(on_ground, radio, phase, cut_s)


@pytest.mark.slow
@pytest.mark.parametrize("cut_s", [3.0, 15.0])
@PHASES
@RADIOS
def test_the_same_holds_for_a_rover_that_drives(
    driving: Hosts, radio: tuple[str, str], phase: str, cut_s: float
) -> None:
    check_end(driving, radio, phase, cut_s)
