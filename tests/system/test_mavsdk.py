"""MAVSDK flies the embedded autopilot, as it flies PX4, while the bridge is silent."""

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from jezero.schemas.state import StatusCode
from tests.system.bridge_observation import Tap, assert_bridge_silent, recorded_statuses
from tests.system.conftest import Stack, wait_for_status

CLIENT = Path(__file__).with_name("mavsdk_client.py")

pytestmark = pytest.mark.skipif(find_spec("mavsdk") is None, reason="the package mavsdk is not installed")


@pytest.mark.long
def test_mavsdk_arms_takes_off_flies_and_lands_while_the_bridge_is_silent(
    start_stack: Callable[..., Stack], tap: Tap
) -> None:
    stack = start_stack(*tap.words)
    with stack.connect() as vehicle:
        wait_for_status(vehicle, lambda s: s.ready, 60, "ready")
        with recorded_statuses(vehicle) as statuses:
            flight = subprocess.run(
                [sys.executable, str(CLIENT), stack.environment["JEZERO_GCS_PORT"]],
                capture_output=True,
                text=True,
                timeout=150,
                check=False,
            )
        assert flight.returncode == 0, f"{flight.stdout}\n{flight.stderr}"
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE and s.ready, 15, "ready again")
    lines = [json.loads(line) for line in flight.stdout.splitlines() if line.startswith("{")]
    reports = {line["step"]: line for line in lines}
    assert reports["connected"]["system_id"] == stack.instance.system_id
    assert reports["telemetry"]["latitude_deg"] == pytest.approx(47.4, abs=1.0)
    assert reports["telemetry"]["voltage_v"] == pytest.approx(16.2, abs=0.3)
    assert (reports["parameters"]["altitude_m"], reports["parameters"]["loss_s"]) == (3.0, 7)
    assert reports["parameters"]["count"] > 40
    assert reports["up"]["in_air"]
    assert reports["offboard"]["mode"] == "OFFBOARD"
    assert reports["offboard"]["speed_mps"] == pytest.approx(1.0, abs=0.2)
    assert 3.0 < reports["offboard"]["moved_m"] < 6.0
    assert "landed" in reports
    assert_bridge_silent(statuses, tap.close(), ["AUTO.TAKEOFF", "OFFBOARD", "AUTO.LAND"])
