"""Missions over real processes: the sender dies, the service dies, and the mission goes on as the file says."""

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
  - go_to: {target_ned_m: [12, 0, -3], speed_mps: 1}
  - go_to: {target_ned_m: [2, 0, -3]}
  - land_on_spot
"""
WATCH = """\
mission: watch
on_failure: {retries: 2, then: stop}
steps:
  - takeoff: {altitude_m: 2}
  - go_to: {target_ned_m: [2, 0, -3]}
  - wait: 20 # s
  - land_on_spot
"""


@pytest.mark.long
def test_a_mission_goes_on_without_its_sender_and_waits_for_a_person_after_a_restart_of_its_service(
    stack: Stack, tmp_path: Path
) -> None:
    file = tmp_path / "patrol.yaml"
    file.write_text(PATROL)
    with stack.connect() as vehicle:
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

        sender = subprocess.Popen([*JEZERO, "mission", "run", "--yes", str(file)], env=stack.environment)
        try:
            wait_for_progress("running", 2, 60)
        finally:
            sender.kill()
            sender.wait()
        os.kill(stack.processes()["mission"], signal.SIGKILL)
        assert wait_for_progress("interrupted", 2, 30).reason == "the mission service was restarted"
        assert vehicle.status().action == "go_to"  # the goal flies on
        assert "interrupted at step 2 of 4" in stack.jezero("mission", "status").stdout
        stack.jezero("mission", "resume")
        wait_for_progress("succeeded", 4, 120)
        assert not vehicle.status().armed


@pytest.mark.long
def test_a_mission_goes_on_while_its_ground_host_is_cut_off(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "watch.yaml"
    file.write_text(WATCH)
    with stack.connect() as vehicle, Relay(int(stack.instance.router.rpartition(":")[2])) as link:
        vehicle.wait_ready()
        ground = {**stack.environment, "JEZERO_ROUTER": f"tcp/127.0.0.1:{link.port}"}
        sender = subprocess.Popen(
            [*JEZERO, "mission", "run", "--yes", str(file)],
            env=ground,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            shown_lines = sender.stdout or iter(())
            wait_for(lambda: "step 2 of 4" in next(shown_lines), 60, "step 2 on the ground host")
            with link.partition():
                wait_for(lambda: vehicle.mission.progress().step == 4, 120, "step 4")
                _, complaint = sender.communicate(timeout=30)
            assert sender.returncode == UNREACHABLE
            assert "the mission goes on; jezero mission status shows it" in complaint
        finally:
            sender.kill()
            sender.wait()
        wait_for(lambda: vehicle.mission.progress().state == "succeeded", 120, "the mission's end")
        assert not vehicle.status().armed
        shown = subprocess.run([*JEZERO, "mission", "status"], env=ground, capture_output=True, text=True, check=True)
        assert "watch: succeeded, 4 steps" in shown.stdout
