"""PX4 in place of the embedded autopilot, over real processes; JEZERO_PX4_DIR names its folder."""

import json
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from benchmarks.px4.process import real_px4
from jezero import Aborted
from jezero.runtime.config import config_directory
from jezero.schemas.state import StatusCode
from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions
from jezero.trials.missions import DEMONSTRATION
from tests.scenario.bridge_restarts import RESTARTS, BridgeFlight
from tests.system.conftest import JEZERO, Stack, has_status, wait_for, wait_for_status
from tests.system.test_profiles import get_ready_apart

pytestmark = pytest.mark.skipif(
    not os.environ.get("JEZERO_PX4_DIR"), reason="JEZERO_PX4_DIR names no folder with PX4's bin/px4 and etc/"
)
LANDS_WITHIN_S = 30.0
BESIDE_MAX_M = 0.07


@pytest.fixture
def start_px4_stack(unstarted: Stack) -> Iterator[Callable[..., Stack]]:
    """`start_stack` with PX4; no process of PX4 is left behind."""
    unstarted.choose_autopilot("px4")

    def start(*words: str) -> Stack:
        stack = unstarted.up(*words)
        assert px4_processes(stack.run_dir)
        return stack

    yield start
    unstarted.jezero("down", check=False)
    assert not px4_processes(unstarted.run_dir)


def px4_processes(run_dir: Path) -> list[int]:
    """Processes in PX4's working directory: PX4, its start script and the script's children."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and (folder / "cwd").readlink() == run_dir / "px4":
                found.append(int(folder.name))
        except OSError:  # it has ended, or belongs to another user
            continue
    return found


def test_the_demonstration_flies_unchanged(tmp_path: Path) -> None:
    environment = {**os.environ, "JEZERO_AUTOPILOT": "px4"}
    done = subprocess.run(
        [*JEZERO, "demo", "--json", "--runs", str(tmp_path)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    events = [json.loads(line) for line in done.stdout.splitlines()]
    goals = [event["goal_id"] for event in events if event.get("outcome") == "succeeded" and "goal_id" in event]
    assert len(goals) == len(DEMONSTRATION)
    (run_dir,) = tmp_path.iterdir()
    log = (run_dir / "logs" / "autopilot.log").read_text()
    assert "Takeoff detected" in log and "Landing detected" in log and "Disarmed by" in log
    assert not px4_processes(run_dir)


def test_when_the_bridge_dies_px4_lands_by_itself(start_px4_stack: Callable[..., Stack], tmp_path: Path) -> None:
    compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
    compose["services"]["vehicle_bridge"]["restart"] = "no"
    (tmp_path / "compose.yaml").write_text(yaml.safe_dump(compose))
    stack = start_px4_stack("-f", str(tmp_path / "compose.yaml"))

    def has_printed(text: str) -> bool:
        return text in stack.jezero("logs", "autopilot").stdout

    with stack.connect() as vehicle:
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)
        os.kill(stack.processes_cached["vehicle_bridge"], signal.SIGKILL)
    wait_for(lambda: has_printed("Failsafe activated"), 5.0, "failsafe")
    wait_for(lambda: has_printed("Disarmed by landing"), LANDS_WITHIN_S, "landed and disarmed")


def test_a_killed_bridge_gets_ready_again_after_px4_has_landed(start_px4_stack: Callable[..., Stack]) -> None:
    """The new bridge has to request what PX4 sent to the one before."""
    stack = start_px4_stack()
    with stack.connect() as vehicle:
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)
        os.kill(stack.processes_cached["vehicle_bridge"], signal.SIGKILL)
        wait_for(lambda: has_status(vehicle), 10.0, "a status of the new bridge")
        assert vehicle.status().code == StatusCode.EXTERNAL
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE, LANDS_WITHIN_S, "landed and disarmed")
        vehicle.wait_ready(10.0)
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)


@pytest.mark.parametrize("profiles", [("sim", "control"), ("control", "sim")])
def test_profiles_started_apart_get_ready_in_either_order(
    unstarted: Stack, tmp_path: Path, profiles: tuple[str, str]
) -> None:
    unstarted.choose_autopilot("px4")
    get_ready_apart(unstarted, tmp_path, profiles)


@pytest.mark.parametrize(("restart", "phase"), RESTARTS)
def test_a_bridge_restarted_in_any_phase_takes_off_again(
    restart: Callable[[BridgeFlight, str], None], phase: str
) -> None:
    """The list of tests/scenario/test_bridge_restarts.py, in lockstep with virtual time."""
    with real_px4(Path(os.environ["JEZERO_PX4_DIR"]), {}) as make:
        restart(BridgeFlight(make()), phase)


def test_a_killed_autopilot_comes_back_with_a_new_vehicle(start_px4_stack: Callable[..., Stack]) -> None:
    stack = start_px4_stack()
    with stack.connect() as vehicle:
        epoch_id = vehicle.status().epoch_id
        goal = vehicle.takeoff(altitude_m=2.0)
        wait_for_status(vehicle, lambda s: s.armed and not s.landed, 15.0, "airborne")
        before = px4_processes(stack.run_dir)
        os.kill(stack.processes_cached["autopilot"], signal.SIGKILL)
        with pytest.raises(Aborted):
            goal.result(timeout_s=10.0)
        wait_for_status(
            vehicle, lambda s: s.ready and s.epoch_id != epoch_id and s.code == StatusCode.IDLE, 30.0, "ready again"
        )
        after = px4_processes(stack.run_dir)
        assert after and not set(before) & set(after)
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=60.0)


def test_a_restarted_simulator_gets_a_new_px4(start_px4_stack: Callable[..., Stack]) -> None:
    """PX4 doesn't connect to a simulator for a second time."""
    stack = start_px4_stack()
    with stack.connect() as vehicle:
        epoch_id = vehicle.status().epoch_id
        before = px4_processes(stack.run_dir)
        os.kill(stack.processes_cached["simulator"], signal.SIGKILL)
        wait_for_status(vehicle, lambda s: s.ready and s.epoch_id != epoch_id, 30.0, "ready again")
        assert not set(before) & set(px4_processes(stack.run_dir))


def test_it_lands_on_a_driving_rover() -> None:
    """Fly in lockstep with virtual time, so that a busy machine makes the flight slower but not worse."""
    with real_px4(Path(os.environ["JEZERO_PX4_DIR"]), {}, always_paced=True) as make:
        landing = fly_landing(0, Conditions(case="uwb+tag", rover="drive"), autopilot=make)
    assert not landing.failure
    assert landing.error_m < BESIDE_MAX_M
