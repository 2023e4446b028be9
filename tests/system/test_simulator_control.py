"""`jezero sim` with real processes: a flight that is paused, stepped, slowed down and reset."""

import json
import time
from typing import Any

import pytest

from jezero.base.frames import distance
from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack, wait_for, wait_for_status

PAUSE_S = 12.0
"""Longer than any time-out of the services, by which they take each other for dead."""
pytestmark = pytest.mark.timeout(300)


def sim(stack: Stack, *words: str) -> dict[str, Any]:
    """State of the world after a command."""
    printed = json.loads(stack.jezero("sim", *words, "--json").stdout.splitlines()[-1])
    state: dict[str, Any] = printed["state"]
    return state


def test_a_flight_that_is_paused_goes_on_and_lands_on_the_rover(stack: Stack) -> None:
    with stack.connect() as uav:
        uav.takeoff(3.0).result()
        goal = uav.go_to(6.0, 0.0, -3.0, speed_mps=0.5)
        wait_for(lambda: uav.odometry().pos_uav_ned_m[0] > 1.0, 60.0, "on the way")
        before = sim(stack, "pause")
        assert before["paused"]
        deadline_s = time.monotonic() + PAUSE_S
        while time.monotonic() < deadline_s:
            assert uav.status().code == StatusCode.GO_TO
            time.sleep(0.5)
        after = sim(stack, "scene")
        assert after["t_ns"] == before["t_ns"]
        assert distance(after["pos_uav_ned_m"], before["pos_uav_ned_m"]) < 1e-6
        stepped = sim(stack, "step", "0.5")
        assert stepped["t_ns"] - after["t_ns"] == 500_000_000
        assert distance(stepped["pos_uav_ned_m"], after["pos_uav_ned_m"]) > 0.1
        rows = json.loads(stack.jezero("ps", "--json").stdout)
        assert not [row["service"] for row in rows if row.get("restarts") or row.get("health") == "failed"]
        sim(stack, "resume")
        goal.result()
        sim(stack, "speed", "0.5")
        wait_for(lambda: sim(stack, "scene")["speed_reached"] == pytest.approx(0.5, abs=0.1), 20.0, "half as fast")
        sim(stack, "speed", "1")
        uav.land_on_spot().result()
        state = sim(stack, "reset")
        assert state["faults"] == []
        wait_for_status(uav, lambda status: status.ready and not status.armed, 60.0, "ready after the reset")
        assert distance(sim(stack, "scene")["pos_uav_ned_m"], (0.0, 0.0, 0.0)) < 0.1


def test_every_control_works_by_command_and_by_sdk_in_a_world_of_a_file(unstarted: Stack) -> None:
    """The world playground has hills, a crater, rocks, boxes, poles, a model, wind and a rover that leans."""
    unstarted.up("--world", "playground")
    with unstarted.connect() as uav:
        world = uav.simulator
        names = [each["name"] for each in sim(unstarted, "scene")["obstacles"]]
        assert names == ["box 1", "box 2", "box 3", "pole 1", "pole 2", "model 1 (lander.obj)"]
        assert [each.name for each in world.state().obstacles] == names
        assert len(uav.ground().obstacles) == len(names)

        assert sim(unstarted, "wind", "2", "90", "--gusts", "0.1")["wind_from_deg"] == 90.0
        assert world.wind(1.0, 180.0).wind_mean_mps == 1.0
        assert sim(unstarted, "fault", "uwb", "off", "--for", "60")["faults"][0]["unit"] == "uwb"
        assert [each.unit for each in world.fault("camera", "slow").faults] == ["uwb", "camera"]
        assert not world.fault("uwb", "ok").faults[1:]
        assert sim(unstarted, "fault", "camera", "ok")["faults"] == []

        refused = unstarted.jezero("sim", "place", "14", "-6", "--rover", check=False)
        assert refused.returncode != 0
        assert "box 1 is there" in refused.stderr
        assert sim(unstarted, "place", "3", "-4", "--rover")["pos_rover_ned_m"][:2] == pytest.approx(
            [3.0, -4.0], abs=0.05
        )
        assert world.place(1.0, 1.0).pos_uav_ned_m[:2] == pytest.approx((1.0, 1.0), abs=0.05)

        assert world.speed(0.5).speed == 0.5
        assert sim(unstarted, "speed", "1")["speed"] == 1.0
        paused = world.pause()
        assert world.step(0.2).t_ns - paused.t_ns == 200_000_000
        assert sim(unstarted, "step", "0.2")["t_ns"] - paused.t_ns == 400_000_000
        assert not sim(unstarted, "resume")["paused"]
        assert sim(unstarted, "pause")["paused"]
        assert not world.resume().paused

        state = world.reset()
        assert (state.wind_mean_mps, state.wind_from_deg) == (3.0, 300.0)
        assert state.pos_rover_ned_m[:2] == pytest.approx((6.0, -2.0), abs=0.05)


def test_a_stack_without_a_simulator_says_so_in_one_sentence(unstarted: Stack) -> None:
    unstarted.jezero("up", "-d", "--profile", "control")

    def said() -> str:
        done = unstarted.jezero("sim", "pause", check=False)
        assert done.returncode == 5
        return done.stderr

    wait_for(lambda: "has no simulator: its stack runs without one" in said(), 60.0, "the bridge is there")
    assert said().strip().splitlines()[-1].startswith("unreachable: ")
