"""Processes that freeze, die or are cut off in flight, over a real router.

Promises in seconds hold on a machine with enough processors. Where a test measures one, the time that the processes
concerned have waited for a processor doesn't count. `pytest -rP` shows the measurements.
"""

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

from jezero import Aborted
from jezero.base.config import config_directory
from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.state import StatusCode
from tests.system.conftest import ProcessorWait, Stack, has_status, in_the_air, new_stack, wait_for, wait_for_status

DETECTED_WITHIN_S = 2.0
REPLIES_WITHIN_S = 5.0
TIMEOUT_S = 60.0
"""Deadline of everything without a promise, on a busy machine."""
TOYS = Path(__file__).with_name("toy_services.py")
CORE = {"router", "simulator", "autopilot", "vehicle_bridge"}


def launcher_of(stack: Stack) -> int:
    return int(json.loads((stack.run_dir / "state.json").read_text())["launcher_pid"])


def freeze(stack: Stack, services: Iterable[str]) -> None:
    """Stop the processes of services, and return when the launcher has detected and killed them.

    Raises:
        AssertionError: a detection was too late, by the test's clock or the launcher's own.
    """
    processes = stack.processes()
    launcher = launcher_of(stack)
    ends = {name: os.pidfd_open(processes[name]) for name in services}
    starved = ProcessorWait([launcher, os.getpid()])
    begin_s = time.monotonic()
    for name in ends:
        os.kill(processes[name], signal.SIGSTOP)
    for name, end in ends.items():
        assert select.select([end], [], [], TIMEOUT_S)[0], f"{name} was not killed"
        os.close(end)
    took_s = time.monotonic() - begin_s
    starved_s = starved.seconds()
    for name in ends:
        wait_for(partial(freeze_durations_s, stack, name), TIMEOUT_S, f"{name} is reported as frozen")
        assert freeze_durations_s(stack, name)[-1] < DETECTED_WITHIN_S
    print(f"{', '.join(ends)}: killed {took_s:.2f} s after the freeze ({starved_s:.2f} s without a processor)")
    assert took_s - starved_s < DETECTED_WITHIN_S


def freeze_durations_s(stack: Stack, service: str) -> list[float]:
    """Longest possible duration of each freeze of a service, by the launcher's log."""
    log = (stack.run_dir / "logs" / f"{service}.log").read_text()
    return [float(seconds) for seconds in re.findall(r"was frozen and killed: stopped for ([0-9.]+) s", log)]


def wait_until_back(stack: Stack, services: Iterable[str], before: dict[str, int]) -> None:
    """Wait until services have new processes that are healthy."""

    def is_back() -> bool:
        rows = {row["service"]: row for row in json.loads(stack.jezero("ps", "--json").stdout)}
        return all(rows[name]["healthy"] and rows[name]["pid"] != before[name] for name in services)

    wait_for(is_back, TIMEOUT_S, f"{', '.join(services)} restarted")


def row_of(stack: Stack, service: str) -> dict[str, Any]:
    """The row of one service in `jezero ps`."""
    rows = json.loads(stack.jezero("ps", "--json").stdout)
    return next(row for row in rows if row["service"] == service)


def changed(stack: Stack, before: dict[str, int]) -> set[str]:
    """Services whose process is another one than before."""
    after = stack.processes()
    return {name for name, pid in before.items() if after.get(name) != pid}


def all_reply(session: zenoh.Session, stack: Stack) -> bool:
    """Whether the bridge and every action server reply."""
    vehicle = stack.instance.vehicle
    cancels = [topics.key(vehicle, action.cancel.name) + "?goal_id=nobody" for action in topics.ACTIONS.values()]
    queries = [*cancels, topics.key(vehicle, topics.STATUS.name)]
    return all(any(reply.ok for reply in session.get(query, timeout=1.0)) for query in queries)


@pytest.mark.long
def test_frozen_action_servers_are_restarted_while_the_vehicle_hovers(shared_stack: Stack) -> None:
    before = shared_stack.processes()
    servers = set(before) - CORE
    assert set(topics.ACTIONS) <= servers
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        freeze(shared_stack, servers)
        assert vehicle.status().code == StatusCode.HOVER
        wait_until_back(shared_stack, servers, before)
        vehicle.go_to(0.0, 1.0, -2.0).result(timeout_s=TIMEOUT_S)
    assert changed(shared_stack, before) == servers


@pytest.mark.long
def test_a_bridge_that_freezes_leaves_the_landing_to_the_autopilot_and_takes_off_again(shared_stack: Stack) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        goal = vehicle.go_to(3.0, 0.0, -3.0, speed_mps=0.5)
        freeze(shared_stack, ["vehicle_bridge"])
        with pytest.raises(Aborted, match=r"the vehicle bridge (has been silent|restarted)|no odometry for") as ended:
            goal.result(timeout_s=TIMEOUT_S)
        assert "the vehicle restarted" not in ended.value.reason
        wait_until_back(shared_stack, ["vehicle_bridge"], before)
        wait_for(lambda: has_status(vehicle), TIMEOUT_S, "a status of the new bridge")
        codes = []
        for status in vehicle.watch_status():
            codes.append(status.code)
            if status.code == StatusCode.IDLE:
                break
        assert codes[0] == StatusCode.EXTERNAL and set(codes) == {StatusCode.EXTERNAL, StatusCode.IDLE}
        in_the_air(vehicle)
    assert changed(shared_stack, before) == {"vehicle_bridge"}


@pytest.mark.long
def test_frozen_autopilot_and_simulator_are_restarted_and_a_new_vehicle_gets_ready(shared_stack: Stack) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle:
        epoch_id = vehicle.wait_ready(TIMEOUT_S).epoch_id
        freeze(shared_stack, ["autopilot", "simulator"])
        wait_for_status(vehicle, lambda s: s.epoch_id not in (0, epoch_id), TIMEOUT_S, "a new epoch")
        vehicle.wait_ready(TIMEOUT_S)
    assert changed(shared_stack, before) == {"autopilot", "simulator"}


@pytest.mark.long
@pytest.mark.parametrize("service", ["autopilot", "simulator"])
def test_when_autopilot_or_simulator_dies_goals_are_aborted_and_a_new_vehicle_gets_ready(
    shared_stack: Stack, service: str
) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        epoch_id = vehicle.status().epoch_id
        goal = vehicle.go_to(10.0, 0.0, -3.0, speed_mps=0.5)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, TIMEOUT_S, "flying to the target")
        os.kill(before[service], signal.SIGKILL)
        begin_s = time.monotonic()
        with pytest.raises(Aborted, match=r"no odometry for|no setpoint for|the vehicle restarted|respawned"):
            goal.result(timeout_s=TIMEOUT_S)
        wait_for_status(vehicle, lambda s: s.epoch_id not in (0, epoch_id), TIMEOUT_S, "a new epoch")
        assert vehicle.status().code in (StatusCode.EXTERNAL, StatusCode.IDLE)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE, TIMEOUT_S, "the new vehicle's IDLE")
        vehicle.wait_ready(TIMEOUT_S)
        print(f"{service}: a new vehicle is ready after {time.monotonic() - begin_s:.1f} s")
        in_the_air(vehicle)
    assert changed(shared_stack, before) == {service}


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_router_that_dies_or_freezes_comes_back_and_no_other_service_is_restarted(
    shared_stack: Stack, number: signal.Signals
) -> None:
    before = shared_stack.processes()
    with shared_stack.connect() as vehicle, zenoh.open(client_config(shared_stack.instance.router)) as session:
        in_the_air(vehicle)
        goal = vehicle.go_to(10.0, 0.0, -3.0, speed_mps=0.5)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, TIMEOUT_S, "flying to the target")
        starved = ProcessorWait([*before.values(), os.getpid()])
        begin_s = time.monotonic()
        if number == signal.SIGKILL:
            os.kill(before["router"], signal.SIGKILL)
        else:
            freeze(shared_stack, ["router"])
        wait_for(lambda: all_reply(session, shared_stack), TIMEOUT_S, "replies")
        took_s = time.monotonic() - begin_s
        starved_s = starved.seconds(started=[shared_stack.processes()["router"]])
        print(f"all reply after {took_s:.2f} s (all together {starved_s:.2f} s without a processor)")
        assert took_s - starved_s < REPLIES_WITHIN_S
        assert changed(shared_stack, before) == {"router"}
        try:
            goal.result(timeout_s=TIMEOUT_S)
            # A killed router may be back before the goal misses a message. A frozen one is missed for a second or more.
            assert number == signal.SIGKILL, "the goal went on without a router"
        except Aborted as aborted:
            assert re.search(r"no odometry for|no setpoint for|has been silent", str(aborted))
        wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, TIMEOUT_S, "hovering")
        vehicle.go_to(0.0, 0.0, -2.0).result(timeout_s=TIMEOUT_S)


@pytest.mark.long
def test_a_hung_service_is_restarted_and_a_crash_loop_is_given_up_with_the_reason(tmp_path: Path) -> None:
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
        wait_for(lambda: row_of(stack, "go_to")["state"] == "failed", TIMEOUT_S, "given up")
        reason = "crash loop: ended 6 times within 60 s; last it ended with SIGKILL"
        assert (row_of(stack, "go_to")["text"], row_of(stack, "go_to")["restarts"]) == (reason, 5)
        assert re.search(rf"go_to +failed .* {reason}\n", stack.jezero("ps").stdout)
        assert f"not ready: go_to failed: {reason}" in stack.jezero("ps").stdout
        assert "is the stack up?" in stack.jezero("target", "0", "0", "-2", check=False).stderr
        log = stack.run_dir / "logs" / "hung.log"
        wait_for(lambda: "was frozen and killed: no report for 10." in log.read_text(), TIMEOUT_S, "the hang detected")
        wait_for(lambda: bool(row_of(stack, "hung")["pid"]), TIMEOUT_S, "restarted")


def test_after_a_stall_of_the_whole_machine_no_service_is_restarted(shared_stack: Stack) -> None:
    """All processes stop at the same time, as in a suspend to disk or a halted virtual machine."""
    before = shared_stack.processes()
    processes = [launcher_of(shared_stack), *before.values()]
    for pid in processes:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(3.0)  # the stall
    for pid in processes:
        os.kill(pid, signal.SIGCONT)
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
    assert not changed(shared_stack, before)


@pytest.mark.long
@pytest.mark.parametrize(
    ("still_s", "between_s"),
    [
        pytest.param(0.4, (0.5,) * 3, marks=pytest.mark.slow),
        (1.2, (0.5,) * 3),
        (0.7, (0.5, 0.015, 0.2, 0.005, 0.025, 0.1) * 2),
    ],
)
def test_a_machine_that_stands_still_for_a_moment_costs_no_goal(
    shared_stack: Stack, still_s: float, between_s: tuple[float, ...]
) -> None:
    """No process runs for a moment, as in a virtual machine on a busy host, and no vehicle time passes."""
    processes = [launcher_of(shared_stack), *shared_stack.processes().values()]
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        vehicle.go_to(0.0, 0.0, -2.0).result(timeout_s=60)
        goal = vehicle.go_to(4.0, 0.0, -2.0)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, 10, "on its way")
        for seconds in between_s:
            time.sleep(seconds)
            pause(processes, still_s)
        goal.result(timeout_s=60)


def test_an_action_server_that_stands_still_for_less_than_a_second_costs_no_goal(shared_stack: Stack) -> None:
    with shared_stack.connect() as vehicle:
        in_the_air(vehicle)
        goal = vehicle.go_to(6.0, 0.0, -2.0, speed_mps=2.0)
        wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, TIMEOUT_S, "on its way")
        for _ in range(2):
            time.sleep(0.5)
            pause([shared_stack.processes()["go_to"]], 0.6)
            wait_for_status(vehicle, lambda s: s.text.endswith("goes on"), TIMEOUT_S, "the goal goes on")
        goal.result(timeout_s=TIMEOUT_S)


def pause(processes: Sequence[int], seconds: float) -> None:
    """Stop all processes and continue them.

    The first one is the launcher. It continues last, because it would kill processes that are still stopped.
    """
    try:
        for pid in processes:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(seconds)
    finally:
        for pid in reversed(processes):
            os.kill(pid, signal.SIGCONT)
