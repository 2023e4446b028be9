"""The hardware path: a stack without a simulator flies the twin, whose flight controller is behind a serial line."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from jezero import Unreachable, Vehicle
from jezero.deploy.twin.twin import CONTROLLER, SETTINGS
from jezero.schemas.state import StatusCode
from tests.system.conftest import JEZERO, Stack, settings_without_pictures, wait_for, wait_for_status

pytestmark = [pytest.mark.timeout(400)]
START_TIMEOUT_S = 120.0
"""Autopilot and stack start with many processes at once."""
FLIGHT_TIMEOUT_S = 120.0


@contextmanager
def running_twin(folder: Path, *words: str, key: Path | None = None) -> Iterator["subprocess.Popen[bytes]"]:
    """The twin as a process of its own, without pictures; with a key its flight controller signs."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JEZERO_")}
    environment["JEZERO_CONFIG_DIR"] = str(settings_without_pictures(folder / "settings of the twin"))
    if key is not None:
        environment["JEZERO_MAVLINK_KEY_FILE"] = str(key)
    with (folder / "twin.log").open("wb") as log:
        command = [*JEZERO, "twin", "--folder", str(folder / "twin"), *words]
        twin = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
    try:
        wait_for((folder / "twin" / CONTROLLER).is_symlink, START_TIMEOUT_S, "the twin has a serial line")
        yield twin
    finally:
        twin.send_signal(signal.SIGINT)
        assert twin.wait(timeout=60) == 0, (folder / "twin.log").read_text()


def fly_it(stack: Stack, folder: Path) -> None:
    stack.environment |= {"JEZERO_CONFIG_DIR": str(folder / "twin" / SETTINGS)}
    stack.jezero("up", "-d", "--profile", "onboard")


def bad_signatures(stack: Stack) -> int:
    """Number of messages whose signature the bridge refused.

    A few are refused on a line that nobody reads for a while, as when a bridge starts: the line then loses bytes, and
    where these are bytes of a signature, the rest of the message is still valid.
    """
    found = re.search(r"(\d+) messages without a valid signature", stack.jezero("ps").stdout)
    return int(found[1]) if found else 0


def is_handed_over(uav: Vehicle) -> bool:
    """Whether a new bridge has found the vehicle in the air; not while no bridge runs."""
    try:
        return uav.status().code == StatusCode.EXTERNAL
    except Unreachable:
        return False


@pytest.mark.long
def test_the_twin_takes_off_flies_and_lands_over_a_narrow_serial_line(unstarted: Stack, tmp_path: Path) -> None:
    with running_twin(tmp_path, "--baud", "57600"):
        fly_it(unstarted, tmp_path)
        with unstarted.connect() as uav:
            uav.wait_ready(START_TIMEOUT_S)
            uav.takeoff(altitude_m=3.0).result(FLIGHT_TIMEOUT_S)
            uav.go_to(4.0, 2.0, -3.0).result(FLIGHT_TIMEOUT_S)
            where = uav.status().odometry
            assert where is not None
            assert where.pos_uav_ned_m == pytest.approx((4.0, 2.0, -3.0), abs=0.6)
            uav.land_on_spot((4.0, 2.0, 0.0), use_uwb=False, use_tag=False).result(FLIGHT_TIMEOUT_S)
            assert uav.status().code == StatusCode.IDLE
        health = unstarted.jezero("ps").stdout
        assert "its clock is known within" in health
        assert "the line is too narrow for ODOMETRY" in health


@pytest.mark.long
def test_a_signed_line_flies_and_a_stack_without_its_key_is_told_so(unstarted: Stack, tmp_path: Path) -> None:
    key = tmp_path / "mavlink.key"
    key.touch(0o600)
    key.write_text("a text that nobody guesses")
    with running_twin(tmp_path, key=key):
        fly_it(unstarted, tmp_path)
        wait_for(
            lambda: "takes no others: name its key" in unstarted.jezero("ps").stdout, START_TIMEOUT_S, "a key is wanted"
        )
        unstarted.jezero("down")
        unstarted.environment["JEZERO_MAVLINK_KEY_FILE"] = str(key)
        fly_it(unstarted, tmp_path)
        with unstarted.connect() as uav:
            uav.wait_ready(START_TIMEOUT_S)
            uav.takeoff(altitude_m=3.0).result(FLIGHT_TIMEOUT_S)
            uav.land_on_spot((0.0, 0.0, 0.0), use_uwb=False, use_tag=False).result(FLIGHT_TIMEOUT_S)
        assert bad_signatures(unstarted) < 10


@pytest.mark.long
def test_a_bridge_that_dies_over_the_twin_and_a_plug_that_is_pulled_cost_the_goal_and_no_more(
    unstarted: Stack, tmp_path: Path
) -> None:
    with running_twin(tmp_path, "--baud", "921600") as twin:
        fly_it(unstarted, tmp_path)
        with unstarted.connect() as uav:
            uav.wait_ready(START_TIMEOUT_S)
            uav.takeoff(altitude_m=3.0).result(FLIGHT_TIMEOUT_S)
            health = unstarted.jezero("ps").stdout
            assert "its clock is known within" in health
            assert "the line is too narrow" not in health
            epoch_id = uav.status().epoch_id
            before = unstarted.processes()["vehicle_bridge"]
            os.kill(before, signal.SIGKILL)
            wait_for(lambda: unstarted.processes().get("vehicle_bridge", before) != before, 60, "a new bridge runs")
            wait_for(lambda: is_handed_over(uav), 60, "a new bridge replies")
            uav.hover()
            wait_for_status(uav, lambda status: status.code == StatusCode.HOVER, 60, "the new bridge has control")
            assert uav.status().epoch_id == epoch_id

            twin.send_signal(signal.SIGUSR1)
            wait_for_status(
                uav, lambda status: "missing" in status.not_ready_reason, 60, "the bridge says what is missing"
            )
            time.sleep(2.0)  # the controller's own failsafe begins
            twin.send_signal(signal.SIGUSR1)
            wait_for_status(uav, lambda s: s.ready and s.code == StatusCode.IDLE, FLIGHT_TIMEOUT_S, "landed, and ready")
            uav.takeoff(altitude_m=2.0).result(FLIGHT_TIMEOUT_S)
