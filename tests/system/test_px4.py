"""PX4 in place of the embedded autopilot, over real processes; JEZERO_PX4_DIR names its folder."""

import json
import math
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import yaml
from pymavlink import mavutil

from benchmarks.px4.process import real_px4
from jezero import Aborted
from jezero.base.config import config_directory
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge.fence import AUTOPILOT_MARGIN_M
from jezero.trials.landing.flight import fly_landing
from jezero.trials.landing.trial import Conditions
from jezero.trials.missions import DEMONSTRATION
from tests.scenario.bridge_restarts import RESTARTS, BridgeFlight
from tests.system.conftest import JEZERO, Stack, has_status, wait_for, wait_for_status
from tests.system.test_profiles import get_ready_apart

pytestmark = [
    pytest.mark.whole,
    pytest.mark.skipif(
        not os.environ.get("JEZERO_PX4_DIR"), reason="JEZERO_PX4_DIR names no folder with PX4's bin/px4 and etc/"
    ),
]
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


def test_a_minute_in_the_air_uses_no_more_of_px4s_battery_than_of_the_vehicles(
    start_px4_stack: Callable[..., Stack],
) -> None:
    with start_px4_stack().connect() as vehicle:
        vehicle.takeoff(altitude_m=3.0).result(timeout_s=60)
        begin_s = time.monotonic()
        for status in vehicle.watch_status():
            assert status.code == StatusCode.HOVER, status.text
            assert status.battery is not None and (status.battery.remaining or 0.0) > 0.85
            if time.monotonic() - begin_s > 50.0:
                break


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


FENCE = """
fence: field
keep_in: [[-10, -10], [10, -10], [10, 10], [-10, 10]]
keep_out: {crater: [[2, -9], [9, -9], [9, -3], [2, -3]]}
"""
METRES_PER_DEGREE = 111_319.5


def stored_fence(ground: Any) -> list[Any]:
    """The items of PX4's own geofence, as a ground station downloads them."""
    m = mavutil.mavlink
    target = ground.target_system, 1
    ground.mav.mission_request_list_send(*target, m.MAV_MISSION_TYPE_FENCE)
    count = ground.recv_match(type="MISSION_COUNT", blocking=True, timeout=5)
    items = []
    for number in range(count.count):
        ground.mav.mission_request_int_send(*target, number, m.MAV_MISSION_TYPE_FENCE)
        items.append(ground.recv_match(type="MISSION_ITEM_INT", blocking=True, timeout=5))
    ground.mav.mission_ack_send(*target, m.MAV_MISSION_ACCEPTED, m.MAV_MISSION_TYPE_FENCE)
    return items


def reposition_north(ground: Any, corners: Sequence[Any], north_m: float) -> None:
    """Command, as a pilot, a flight to a point north of the middle of a polygon."""
    m, middle = mavutil.mavlink, [sum(each) / len(corners) for each in zip(*((c.x, c.y) for c in corners), strict=True)]
    changes_mode = m.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
    place = round(middle[0] + 1e7 * north_m / METRES_PER_DEGREE), round(middle[1]), math.nan
    ground.mav.command_int_send(
        ground.target_system,
        1,
        m.MAV_FRAME_GLOBAL,
        m.MAV_CMD_DO_REPOSITION,
        0,
        0,
        -1,
        changes_mode,
        0,
        math.nan,
        *place,
    )


def test_px4_stores_the_fence_and_takes_no_pilot_beyond_it(
    start_px4_stack: Callable[..., Stack], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAVLINK20", "1")
    file = tmp_path / "field.yaml"
    file.write_text(FENCE)
    stack = start_px4_stack()
    ground = mavutil.mavlink_connection(f"udpin:127.0.0.1:{stack.instance.gcs_port}", source_system=255)
    assert ground.wait_heartbeat(timeout=10)
    stack.jezero("fence", "set", str(file))
    wait_for(lambda: len(stored_fence(ground)) == 8, 15.0, "the fence is stored")
    items = stored_fence(ground)
    for corners, size_m in ((items[:4], 20.0 + 2 * AUTOPILOT_MARGIN_M), (items[4:], 7.0 - 2 * AUTOPILOT_MARGIN_M)):
        north_m = [1e-7 * item.x * METRES_PER_DEGREE for item in corners]
        assert max(north_m) - min(north_m) == pytest.approx(size_m, abs=0.1)
    with stack.connect() as vehicle:
        vehicle.takeoff(altitude_m=3.0).result(timeout_s=60)
        reposition_north(ground, items[:4], 20.0)
        wait_for(lambda: "eofence" in stack.jezero("logs", "autopilot").stdout, 15.0, "PX4 names its geofence")
        seen = [status.odometry for status in islice(vehicle.watch_status(), 100)]
        assert max(odometry.pos_uav_ned_m[0] for odometry in seen if odometry) < 10.0 + AUTOPILOT_MARGIN_M + 1.0


def test_it_lands_on_a_driving_rover() -> None:
    """Fly in lockstep with virtual time, so that a busy machine makes the flight slower but not worse."""
    with real_px4(Path(os.environ["JEZERO_PX4_DIR"]), {}, always_paced=True) as make:
        landing = fly_landing(0, Conditions(case="uwb+tag", rover="drive"), autopilot=make)
    assert not landing.failure
    assert landing.error_m < BESIDE_MAX_M
