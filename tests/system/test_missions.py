"""Missions over real processes: the sender is cut off, the service dies, and the mission goes on as the file says."""

import os
import signal
import subprocess
from pathlib import Path

import pytest

from jezero import Unreachable
from jezero.cli.terminal import UNREACHABLE
from jezero.schemas.mission import MissionProgress
from tests.system.conftest import JEZERO, Stack, wait_for
from tests.system.relay import Relay

PATROL = """\
mission: patrol
on_failure: {retries: 2, then: stop} # a machine that other tests load may delay the setpoints of a goal
steps:
  - takeoff: {altitude_m: 2}
  - go_to: {target_ned_m: [16, 0, -3], speed_mps: 0.5}
  - go_to: {target_ned_m: [2, 0, -3]}
  - land_on_spot
"""


@pytest.mark.long
def test_a_mission_goes_on_while_its_sender_is_cut_off_and_waits_for_a_person_after_a_restart_of_its_service(
    stack: Stack, tmp_path: Path
) -> None:
    file = tmp_path / "patrol.yaml"
    file.write_text(PATROL)
    with stack.connect() as vehicle, Relay(int(stack.instance.router.rpartition(":")[2])) as link:
        vehicle.wait_ready()

        def reached(state: str, step: int) -> bool:
            try:
                progress = vehicle.mission.progress()
            except Unreachable:  # the service starts
                return False
            assert progress.state != "failed", progress.reason
            return (progress.state, progress.step) == (state, step)

        def wait_for_progress(state: str, step: int, timeout_s: float) -> MissionProgress:
            wait_for(lambda: reached(state, step), timeout_s, f"step {step}, {state}")
            return vehicle.mission.progress()

        ground = {**stack.environment, "JEZERO_ROUTER": f"tcp/127.0.0.1:{link.port}"}
        sender = subprocess.Popen(
            [*JEZERO, "mission", "run", "--yes", str(file)], env=ground, stderr=subprocess.PIPE, text=True
        )
        try:
            wait_for_progress("running", 2, 60)
            with link.partition():
                _, complaint = sender.communicate(timeout=60)
        finally:
            sender.kill()
            sender.wait()
        assert sender.returncode == UNREACHABLE
        assert "the mission goes on; jezero mission status shows it" in complaint
        os.kill(stack.processes()["mission"], signal.SIGKILL)
        assert wait_for_progress("interrupted", 2, 30).reason == "the mission service was restarted"
        assert vehicle.status().action == "go_to"  # the goal flies on
        assert "interrupted at step 2 of 4" in stack.jezero("mission", "status").stdout
        stack.jezero("mission", "resume")
        wait_for_progress("succeeded", 4, 120)
        assert not vehicle.status().armed
        shown = subprocess.run([*JEZERO, "mission", "status"], env=ground, capture_output=True, text=True, check=True)
        assert "patrol: succeeded, 4 steps" in shown.stdout
