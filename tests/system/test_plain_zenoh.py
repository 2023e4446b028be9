"""A client with nothing but Zenoh flies, and wildcards have no effect."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import zenoh

from jezero import JezeroError, Vehicle
from jezero.schemas.state import StatusCode
from tests.system.conftest import Stack, in_the_air, wait_for, wait_for_status

PLAIN_CLIENT = """
import json, sys, zenoh
router, selector = sys.argv[1:]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([router]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    replies = session.get(selector, timeout=60.0, consolidation=zenoh.ConsolidationMode.NONE)
    for reply in replies:
        print(reply.ok.payload.to_string(), flush=True)
assert "jezero" not in sys.modules
"""


@pytest.mark.long
def test_a_plain_zenoh_session_takes_off_with_a_selector_and_gets_streamed_feedback(shared_stack: Stack) -> None:
    # The first test of the file: the vehicle stands on the ground.
    selector = f"jezero/{shared_stack.instance.vehicle}/@action/takeoff?altitude_m=3;_time=[..]"
    command = [sys.executable, "-c", PLAIN_CLIENT, shared_stack.instance.router, selector]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        arrivals = [(time.monotonic(), json.loads(line)) for line in client.stdout]
        assert client.wait(timeout=10) == 0
    kinds = [reply["type"] for _, reply in arrivals]
    assert kinds[0] == "accepted" and kinds[-1] == "result"
    assert kinds[1:-1] == ["feedback"] * (len(kinds) - 2)
    assert len(kinds) > 20
    assert arrivals[-1][0] - arrivals[1][0] > 2.0  # streamed, not delivered at the end
    assert arrivals[-1][1]["outcome"] == "succeeded"
    with shared_stack.connect() as vehicle:
        wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, 1.0, "hovering")
        odometry = vehicle.status().odometry
        assert odometry is not None and abs(odometry.pos_uav_ned_m[2] + 3.0) < 0.3
        pause_resume_and_modify_from_everywhere(shared_stack, vehicle)


def pause_resume_and_modify_from_everywhere(stack: Stack, vehicle: Vehicle) -> None:
    """A goal of the SDK is paused by plain Zenoh, by the command line and by the SDK."""
    goal = vehicle.go_to(15.0, 0.0, -3.0, speed_mps=1.0)
    assert zenoh_get(stack, f"@action/go_to/pause?goal_id={goal.goal_id}") == [{"paused": True, "reason": ""}]
    wait_for_status(vehicle, lambda s: s.paused and s.code == StatusCode.GO_TO, 5.0, "paused")
    assert f"goal {goal.goal_id} goes on" in printed(stack, "resume")
    wait_for_status(vehicle, lambda s: not s.paused, 5.0, "going on")
    goal.pause()
    assert vehicle.status().paused
    assert f"modified goal {goal.goal_id}" in printed(stack, "modify", "target_ned_m=[2,2,-3]", "speed_mps=2")
    assert "frame can't change" in printed(stack, "modify", "frame=rover")
    assert "'fast' is not KEY=VALUE" in printed(stack, "modify", "fast")
    goal.resume()
    north_m, east_m, _ = goal.result(timeout_s=60).pos_uav_ned_m
    assert abs(north_m - 2.0) < 0.5 and abs(east_m - 2.0) < 0.5
    assert "no goal is in charge" in printed(stack, "pause")


def printed(stack: Stack, *words: str) -> str:
    """All that a command prints, whether or not it fails."""
    done = stack.jezero(*words, check=False)
    return done.stdout + done.stderr


ZENOH = str(Path(sys.executable).parent / "zenoh")


def zenoh_get(stack: Stack, name: str) -> list[Any]:
    """Replies to a query that is sent with the command `zenoh`, as a user would."""
    command = [ZENOH, "--mode", "client", "--connect", stack.instance.router, "get", "--decoder", "text"]
    selector = f"jezero/{stack.instance.vehicle}/{name}"
    done = subprocess.run([*command, "--selector", selector], capture_output=True, text=True, timeout=30, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.long
def test_a_running_stack_describes_its_actions_as_the_command_line_does(shared_stack: Stack) -> None:
    descriptions = {found["name"]: found for found in zenoh_get(shared_stack, "action/*/description")}
    lines = shared_stack.jezero("info", "actions", "--json").stdout.splitlines()
    assert descriptions == {action["name"]: action for action in map(json.loads, lines)}
    assert zenoh_get(shared_stack, "action/go_to/description") == [descriptions["go_to"]]


@pytest.mark.long
def test_a_goal_of_an_action_that_does_not_exist_is_refused_with_the_nearest_that_does(shared_stack: Stack) -> None:
    (refusal,) = zenoh_get(shared_stack, "@action/takeof?altitude_m=3;_time=[..]")
    assert (refusal["type"], refusal["reason"].startswith("there is no action 'takeof'")) == ("rejected", True)
    assert "did you mean 'takeoff'? Known are takeoff, go_to," in refusal["reason"]
    (plan,) = zenoh_get(shared_stack, "@action/takeof/plan?altitude_m=3")
    assert (plan["accepted"], plan["reason"]) == (False, refusal["reason"])
    # Refused by the action server, and by nobody else:
    (understood,) = zenoh_get(shared_stack, "@action/takeoff?height=3")
    assert "there is no field 'height'; known are altitude_m" in understood["reason"]


@pytest.mark.long
def test_an_action_whose_server_is_gone_is_unreachable_and_not_unknown(shared_stack: Stack) -> None:
    with shared_stack.connect() as vehicle:
        os.kill(shared_stack.processes()["go_to"], signal.SIGKILL)

        def reason() -> str:
            try:
                vehicle.plan("go_to", target_ned_m=(0.0, 0.0, -3.0))
            except JezeroError as error:
                return str(error)
            return ""

        wait_for(lambda: reason().startswith("no server replies on @action/go_to"), 5.0, "unreachable")


@pytest.mark.long
def test_wildcard_get_put_and_delete_change_nothing(shared_stack: Stack) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([shared_stack.instance.router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    prefix = f"jezero/{shared_stack.instance.vehicle}"
    bodies = [b"{}", b"", b'{"altitude_m": 2}', b"\xff", b'{"confirm": true}']
    with shared_stack.connect() as vehicle, zenoh.open(config) as session:
        in_the_air(vehicle)
        before = vehicle.status()
        for pattern in ("**", f"{prefix}/**", f"{prefix}/*", f"{prefix}/*/*", f"{prefix}/@action/*", f"{prefix}/@*/**"):
            for body in bodies:
                try:
                    session.put(pattern, body)
                    session.delete(pattern)
                    replies = list(session.get(pattern, payload=body, timeout=1.0))
                except zenoh.ZError:
                    continue  # Zenoh itself refuses the pattern
                for reply in replies:
                    assert reply.ok is None or "@" not in str(reply.ok.key_expr), reply.ok.key_expr
        time.sleep(0.5)
        after = vehicle.status()
        assert (after.code, after.armed, after.grant) == (before.code, True, before.grant)
        assert before.odometry is not None and after.odometry is not None
        assert abs(after.odometry.pos_uav_ned_m[2] - before.odometry.pos_uav_ned_m[2]) < 0.5
        vehicle.land_on_spot(spot_ned_m=(0.0, 0.0, 0.0), use_uwb=False, use_tag=False).result(timeout_s=90)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE and not s.armed, 10, "landed and disarmed")
