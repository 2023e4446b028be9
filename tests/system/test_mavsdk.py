"""MAVSDK flies the embedded autopilot, as it flies PX4, while the bridge watches."""

import json
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest

from jezero.schemas.state import Status, StatusCode
from tests.system.conftest import Stack, wait_for_status

CLIENT = Path(__file__).with_name("mavsdk_client.py")

pytestmark = pytest.mark.skipif(find_spec("mavsdk") is None, reason="the package mavsdk is not installed")


def test_mavsdk_arms_takes_off_flies_and_lands_while_the_bridge_keeps_still(stack: Stack) -> None:
    port = stack.environment["JEZERO_GCS_PORT"]
    statuses: list[Status] = []
    stop = threading.Event()

    with stack.connect() as vehicle:
        wait_for_status(vehicle, lambda s: s.ready, 60, "ready")

        def watch() -> None:
            while not stop.wait(0.05):
                statuses.append(vehicle.status())

        watcher = threading.Thread(target=watch)
        watcher.start()
        try:
            flight = subprocess.run(
                [sys.executable, str(CLIENT), port], capture_output=True, text=True, timeout=150, check=False
            )
        finally:
            stop.set()
            watcher.join()
        assert flight.returncode == 0, f"{flight.stdout}\n{flight.stderr}"
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE and s.ready, 15, "ready again")
    lines = [json.loads(line) for line in flight.stdout.splitlines() if line.startswith("{")]
    said = {line["what"]: line for line in lines}
    assert said["connected"]["system_id"] == stack.instance.system_id
    assert said["telemetry"]["latitude_deg"] == pytest.approx(47.4, abs=1.0)
    assert said["telemetry"]["voltage_v"] == pytest.approx(16.2, abs=0.3)
    assert (said["parameters"]["altitude_m"], said["parameters"]["loss_s"]) == (3.0, 7)
    assert said["parameters"]["count"] > 40
    assert said["up"]["in_air"]
    assert said["offboard"]["mode"] == "OFFBOARD"
    assert said["offboard"]["speed_mps"] == pytest.approx(1.0, abs=0.2)
    assert 3.0 < said["offboard"]["moved_m"] < 6.0
    assert "landed" in said
    _assert_that_the_bridge_only_watched(statuses)


def _assert_that_the_bridge_only_watched(statuses: list[Status]) -> None:
    armed = [s for s in statuses if s.armed]
    watched = [s for s in armed if s.code == StatusCode.EXTERNAL]
    assert len(watched) >= len(armed) - 2  # armed may be known an instant before the status changes
    assert {s.in_charge for s in watched} == {"external"}
    modes = [mode for mode in dict.fromkeys(s.autopilot_mode for s in watched) if mode != "AUTO.LOITER"]
    assert modes == ["AUTO.TAKEOFF", "OFFBOARD", "AUTO.LAND"]
    assert not any(s.control_id or s.goal_id for s in watched)
