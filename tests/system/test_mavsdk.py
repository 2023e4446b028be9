"""MAVSDK flies the embedded autopilot, as it flies PX4, while the bridge watches."""

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack, wait_for_status
from tests.system.overheard import Tap, assert_that_the_bridge_only_watched, watching

CLIENT = Path(__file__).with_name("mavsdk_client.py")

pytestmark = pytest.mark.skipif(find_spec("mavsdk") is None, reason="the package mavsdk is not installed")


def test_mavsdk_arms_takes_off_flies_and_lands_while_the_bridge_keeps_still(
    start_stack: Callable[..., Stack], tap: Tap
) -> None:
    stack = start_stack(*tap.words)
    with stack.connect() as vehicle:
        wait_for_status(vehicle, lambda s: s.ready, 60, "ready")
        with watching(vehicle) as seen:
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
    assert_that_the_bridge_only_watched(seen, tap.close(), ["AUTO.TAKEOFF", "OFFBOARD", "AUTO.LAND"])
