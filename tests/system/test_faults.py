"""Processes that freeze, die or are cut off in flight, over a real router.

Promises in seconds are about a machine that has a processor for whoever wants one. Where a test measures one, the time
that the processes concerned have waited for a processor doesn't count. `pytest -rP` shows what was measured.
"""

import contextlib
import json
import os
import re
import select
import signal
import time
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
import zenoh

from jezero import Aborted, Unreachable, Vehicle
from jezero.runtime.config import config_directory
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from jezero.zenoh_client import client_config
from tests.system.conftest import ProcessorWait, Stack, new_stack, wait_for, wait_for_status

NOTICED_S = 2.0
RESUMED_S = 5.0
PATIENCE_S = 60.0
"""For what has no promise, on a machine that is busy with other things."""
TOYS = Path(__file__).with_name("toy_services.py")
CORE = {"router", "simulator", "autopilot", "vehicle_bridge"}


def launcher_of(stack: Stack) -> int:
    return int(json.loads((stack.run_dir / "state.json").read_text())["launcher_pid"])


def freeze(stack: Stack, services: Iterable[str]) -> None:
    """Stop their processes, and return when the launcher has noticed and killed them.

    Raises:
        AssertionError: one was noticed too late, by the test's clock or the launcher's own.
    """
    processes = stack.processes()
    launcher = launcher_of(stack)
    ends = {name: os.pidfd_open(processes[name]) for name in services}
    starved = ProcessorWait([launcher, os.getpid()])
    begin_s = time.monotonic()
    for name in ends:
        os.kill(processes[name], signal.SIGSTOP)
    for name, end in ends.items():
        assert select.select([end], [], [], PATIENCE_S)[0], f"{name} was not killed"
        os.close(end)
    took_s = time.monotonic() - begin_s
    starved_s = starved.seconds()
    for name in ends:
        wait_for(partial(told_s, stack, name), PATIENCE_S, f"{name} is told to be frozen")
        assert told_s(stack, name)[-1] < NOTICED_S
    print(f"{', '.join(ends)}: killed {took_s:.2f} s after the freeze ({starved_s:.2f} s without a processor)")
    assert took_s - starved_s < NOTICED_S


def told_s(stack: Stack, service: str) -> list[float]:
    """For how long at most the launcher has let each frozen process of a service be."""
    log = (stack.run_dir / "logs" / f"{service}.log").read_text()
    return [float(seconds) for seconds in re.findall(r"was frozen and killed: stopped for ([0-9.]+) s", log)]


def wait_until_back(stack: Stack, services: Iterable[str], before: dict[str, int]) -> None:
    """Until new processes are in their places, and healthy."""

    def is_back() -> bool:
        rows = {row["service"]: row for row in json.loads(stack.jezero("ps", "--json").stdout)}
        return all(rows[name]["healthy"] and rows[name]["pid"] != before[name] for name in services)

    wait_for(is_back, PATIENCE_S, f"{', '.join(services)} started again")


def tells_its_status(vehicle: Vehicle) -> bool:
    """A bridge that was started again is healthy a moment before it has a status to tell."""
    with contextlib.suppress(Unreachable):
        vehicle.status()
        return True
    return False


def row_of(stack: Stack, service: str) -> dict[str, Any]:
    """What `jezero ps` says of one."""
    rows = json.loads(stack.jezero("ps", "--json").stdout)
    return next(row for row in rows if row["service"] == service)


def changed(stack: Stack, before: dict[str, int]) -> set[str]:
    """Services that another process runs than before."""
    after = stack.processes()
    return {name for name, pid in before.items() if after.get(name) != pid}


def in_the_air(vehicle: Vehicle) -> None:
    """Hovering, whatever the test before has left."""
    vehicle.wait_ready(PATIENCE_S)
    wait_for_status(vehicle, lambda s: s.code in (StatusCode.IDLE, StatusCode.HOVER), PATIENCE_S, "at rest")
    if vehicle.status().code == StatusCode.IDLE:
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=PATIENCE_S)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, PATIENCE_S, "hovering")


def answers(session: zenoh.Session, stack: Stack) -> bool:
    """Whether the bridge and every action server answer."""
    vehicle = stack.instance.vehicle
    cancels = [topics.key(vehicle, action.cancel.name) + "?goal_id=nobody" for action in topics.ACTIONS.values()]
    questions = [*cancels, topics.key(vehicle, topics.STATUS.name)]
    return all(any(reply.ok for reply in session.get(question, timeout=1.0)) for question in questions)


def test_frozen_action_servers_are_noticed_and_started_again_while_the_vehicle_hovers(shared_stack: Stack) -> None:
    before = shared_stack.processes()
    servers = set(before) - CORE
    assert set(topics.ACTIONS) <= servers
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        freeze(shared_stack, servers)
        assert vehicle.status().code == StatusCode.HOVER
        wait_until_back(shared_stack, servers, before)
        vehicle.go_to(0.0, 1.0, -2.0).result(timeout_s=PATIENCE_S)
    assert changed(shared_stack, before) == servers


def test_a_frozen_bridge_is_started_again_and_leaves_the_landing_to_the_autopilot(shared_stack: Stack) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        goal = vehicle.go_to(3.0, 0.0, -3.0, speed_mps=0.5)
        freeze(shared_stack, ["vehicle_bridge"])
        with pytest.raises(Aborted, match="the vehicle bridge has been silent"):
            goal.result(timeout_s=PATIENCE_S)
        wait_until_back(shared_stack, ["vehicle_bridge"], before)
        wait_for(lambda: tells_its_status(vehicle), PATIENCE_S, "a status of the new bridge")
        seen = []
        for status in vehicle.watch_status():
            seen.append(status.code)
            if status.code == StatusCode.IDLE:
                break
        assert seen[0] == StatusCode.EXTERNAL and set(seen) == {StatusCode.EXTERNAL, StatusCode.IDLE}
        vehicle.wait_ready(PATIENCE_S)
    assert changed(shared_stack, before) == {"vehicle_bridge"}


def test_frozen_autopilot_and_simulator_are_noticed_and_a_new_vehicle_gets_ready(shared_stack: Stack) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle:
        epoch_id = vehicle.wait_ready(PATIENCE_S).epoch_id
        freeze(shared_stack, ["autopilot", "simulator"])
        wait_for_status(vehicle, lambda s: s.epoch_id not in (0, epoch_id), PATIENCE_S, "a new epoch")
        vehicle.wait_ready(PATIENCE_S)
    assert changed(shared_stack, before) == {"autopilot", "simulator"}


@pytest.mark.parametrize("service", ["autopilot", "simulator"])
def test_when_autopilot_or_simulator_dies_goals_are_aborted_and_a_new_vehicle_gets_ready(
    shared_stack: Stack, service: str
) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        epoch_id = vehicle.status().epoch_id
        goal = vehicle.go_to(10.0, 0.0, -3.0, speed_mps=0.5)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, PATIENCE_S, "flying to the target")
        os.kill(before[service], signal.SIGKILL)
        begin_s = time.monotonic()
        with pytest.raises(Aborted, match=r"no odometry for|no setpoint for|the vehicle restarted|respawned"):
            goal.result(timeout_s=PATIENCE_S)
        wait_for_status(vehicle, lambda s: s.epoch_id not in (0, epoch_id), PATIENCE_S, "a new epoch")
        assert vehicle.status().code in (StatusCode.EXTERNAL, StatusCode.IDLE)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE, PATIENCE_S, "the new vehicle's IDLE")
        vehicle.wait_ready(PATIENCE_S)
        print(f"{service}: a new vehicle is ready after {time.monotonic() - begin_s:.1f} s")
        in_the_air(vehicle)
    assert changed(shared_stack, before) == {service}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_router_that_dies_or_freezes_comes_back_and_no_other_service_is_restarted(
    shared_stack: Stack, number: signal.Signals
) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle, zenoh.open(client_config(shared_stack.instance.router)) as session:
        in_the_air(vehicle)
        goal = vehicle.go_to(10.0, 0.0, -3.0, speed_mps=0.5)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, PATIENCE_S, "flying to the target")
        starved = ProcessorWait([*before.values(), os.getpid()])
        begin_s = time.monotonic()
        if number == signal.SIGKILL:
            os.kill(before["router"], signal.SIGKILL)
        else:
            freeze(shared_stack, ["router"])
        wait_for(lambda: answers(session, shared_stack), PATIENCE_S, "answers")
        took_s = time.monotonic() - begin_s
        starved_s = starved.seconds(started=[shared_stack.processes()["router"]])
        print(f"everybody answers after {took_s:.2f} s (all together {starved_s:.2f} s without a processor)")
        assert took_s - starved_s < RESUMED_S
        assert changed(shared_stack, before) == {"router"}
        with pytest.raises(Aborted, match=r"no odometry for|no setpoint for|has been silent"):
            goal.result(timeout_s=PATIENCE_S)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, PATIENCE_S, "hovering")
        vehicle.go_to(0.0, 0.0, -2.0).result(timeout_s=PATIENCE_S)


def test_what_hangs_is_started_again_and_what_dies_again_and_again_is_given_up_in_words(tmp_path: Path) -> None:
    compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
    services = {name: compose["services"][name] for name in ("router", "go_to")}
    services["hung"] = {"command": f"python {TOYS} hung", "restart": "always"}
    (tmp_path / "compose.yaml").write_text(yaml.safe_dump({"services": services}))
    with new_stack(tmp_path) as stack:
        stack.jezero("up", "-d", "-f", str(tmp_path / "compose.yaml"))
        killed: set[int] = set()
        while len(killed) < 6:
            pid = stack.processes().get("go_to")
            if pid is not None and pid not in killed:
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
        wait_for(lambda: row_of(stack, "go_to")["state"] == "failed", PATIENCE_S, "given up")
        why = "crash loop: ended 6 times within 60 s; last it ended with SIGKILL"
        assert (row_of(stack, "go_to")["text"], row_of(stack, "go_to")["restarts"]) == (why, 5)
        assert re.search(rf"go_to +failed .* {why}\n", stack.jezero("ps").stdout)
        assert f"not ready: go_to failed: {why}" in stack.jezero("ps").stdout
        assert "is the stack up?" in stack.jezero("target", "0", "0", "-2", check=False).stderr
        log = stack.run_dir / "logs" / "hung.log"
        wait_for(
            lambda: "was frozen and killed: no report for 10." in log.read_text(), PATIENCE_S, "the hang is noticed"
        )
        wait_for(lambda: bool(row_of(stack, "hung")["pid"]), PATIENCE_S, "started again")


def test_a_machine_that_stalls_as_a_whole_finds_everybody_alive(shared_stack: Stack) -> None:
    """As after a suspend to disk, or in a virtual machine that was halted."""
    before = shared_stack.processes()
    everybody = [launcher_of(shared_stack), *before.values()]
    for pid in everybody:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(3.0)  # the stall
    for pid in everybody:
        os.kill(pid, signal.SIGCONT)
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
    assert not changed(shared_stack, before)


@pytest.mark.parametrize(
    ("still_s", "between_s"), [(0.4, (0.5,) * 3), (1.2, (0.5,) * 3), (0.7, (0.5, 0.015, 0.2, 0.005, 0.025, 0.1) * 2)]
)
def test_a_machine_that_stands_still_for_a_moment_costs_no_goal(
    stack: Stack, still_s: float, between_s: tuple[float, ...]
) -> None:
    """As a virtual machine does whose host is busy: no process runs, and no time passes for the vehicle."""
    with stack.connect() as vehicle:
        vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)
        goal = vehicle.go_to(4.0, 0.0, -2.0)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, 10, "on its way")
        for seconds in between_s:
            time.sleep(seconds)
            stand_still([launcher_of(stack), *stack.processes_cached.values()], still_s)
        goal.result(timeout_s=60)


def stand_still(processes: Sequence[int], seconds: float) -> None:
    """Stop all of them, and let them go on; the first, the launcher, last, lest it look at those that are stopped."""
    try:
        for pid in processes:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(seconds)
    finally:
        for pid in reversed(processes):
            os.kill(pid, signal.SIGCONT)
