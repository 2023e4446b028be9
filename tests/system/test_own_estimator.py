"""A stack without jezero's estimator, and the one of docs/how-to/write-an-estimator.md beside it."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from jezero import Refused
from jezero.schemas.state import StatusCode
from tests.scenario.test_own_estimator import program
from tests.system.conftest import Stack, wait_for


@pytest.mark.long
def test_an_estimator_beside_a_stack_without_one_lands_on_the_rover(unstarted: Stack, tmp_path: Path) -> None:
    stack = unstarted.up("--profile", "sim", "--profile", "control")
    assert "estimator" not in stack.processes()
    file = tmp_path / "my_estimator.py"
    file.write_text(program())
    with stack.connect() as uav:
        uav.takeoff(altitude_m=3.0).result(timeout_s=60.0)
        with pytest.raises(Refused, match="the estimator is silent"):
            uav.go_to(0.0, 0.0, -3.0, frame="rover")
        with subprocess.Popen([sys.executable, file], env=stack.service_environment) as estimator:
            try:
                wait_for(lambda: uav.relative(timeout_s=10.0).valid, 30.0, "a valid estimate")
                uav.land_on_spot().result(timeout_s=120.0)
                assert uav.status().code == StatusCode.IDLE
            finally:
                estimator.send_signal(signal.SIGTERM)
        assert estimator.returncode == 0
