"""MAVProxy, a process of its own, flies the embedded autopilot from its prompt while the bridge is silent."""

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from jezero import Vehicle
from jezero.base.frames import altitude_m
from jezero.schemas.state import StatusCode
from tests.system.bridge_observation import Tap, assert_bridge_silent, recorded_statuses
from tests.system.conftest import Stack, wait_for, wait_for_status

PROGRAM = os.environ.get("JEZERO_MAVPROXY") or shutil.which("mavproxy.py")

pytestmark = pytest.mark.skipif(
    PROGRAM is None, reason="mavproxy.py is not on the path, and JEZERO_MAVPROXY doesn't name it"
)


class Prompt:
    """MAVProxy with its prompt, in a folder of its own instead of a home.

    PYTHONPATH is removed, because MAVProxy has libraries of its own.
    """

    def __init__(self, port: str, system_id: int, folder: Path) -> None:
        self._log = folder / "mavproxy.log"
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [
                    str(PROGRAM),
                    f"--master=udpin:127.0.0.1:{port}",
                    f"--target-system={system_id}",
                    f"--state-basedir={folder}",
                ],
                cwd=folder,
                env={**environment, "HOME": str(folder), "PYTHONUNBUFFERED": "1"},
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    @property
    def output(self) -> str:
        return self._log.read_text(errors="replace")

    def type(self, line: str, expected: str, timeout_s: float = 10.0) -> None:
        """Give a command and wait for a text in MAVProxy's output."""
        before = len(self.output)
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n".encode())
        self._process.stdin.flush()
        self.wait(expected, timeout_s, before)

    def wait(self, expected: str, timeout_s: float, since: int = 0) -> None:
        try:
            wait_for(lambda: expected in self.output[since:], timeout_s, expected)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.output}") from None

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()


def amsl_m(vehicle: Vehicle) -> float:
    """Altitude of the vehicle above sea level, by the autopilot's own estimate."""
    odometry = vehicle.status().odometry
    assert odometry is not None
    assert odometry.origin_deg is not None
    return odometry.origin_deg[2] + altitude_m(odometry.pos_uav_ned_m[2])


def test_mavproxy_arms_takes_off_and_lands_while_the_bridge_is_silent(
    start_stack: Callable[..., Stack], tap: Tap, tmp_path: Path
) -> None:
    stack = start_stack(*tap.words)
    with stack.connect() as vehicle, recorded_statuses(vehicle) as statuses:
        wait_for_status(vehicle, lambda s: s.ready, 60, "ready")
        prompt = Prompt(stack.environment["JEZERO_GCS_PORT"], stack.instance.system_id, tmp_path)
        try:
            prompt.wait("Received ", 30.0)  # all parameters
            prompt.type("arm throttle", "ARMED")
            start_m = amsl_m(vehicle)
            prompt.type(f"long NAV_TAKEOFF 0 0 0 nan nan nan {start_m + 3.0}", "Mode TAKEOFF")
            prompt.wait("LOITER> Mode LOITER", 30.0, prompt.output.rindex("Mode TAKEOFF"))
            assert 2.0 < amsl_m(vehicle) - start_m < 4.0
            prompt.type("long NAV_LAND 0 0 0 0 0 0 0", "Mode LAND")
            prompt.wait("DISARMED", 60.0, prompt.output.rindex("Mode LAND"))
        finally:
            prompt.close()
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE and s.ready, 15, "ready again")
    assert_bridge_silent(statuses, tap.close(), ["AUTO.TAKEOFF", "AUTO.LAND"])
