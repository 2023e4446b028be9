"""The launcher with real processes: order, restarts, stopping, and no process left behind."""

import json
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from jezero import deploy
from jezero.deploy.launcher.ports import instance_environment, reserved_instance
from jezero.deploy.launcher.state import start_ticks
from jezero.schemas import topics
from jezero.services.vehicle_bridge.kept_fence import NAME as KEPT_FENCE
from tests.system.conftest import Stack, wait_for

SHIPPED = Path(deploy.__path__[0]) / "compose.yaml"
STARTS_WITHIN_S = 20.0
SLEEPER = "{command: sleep 1000, restart: unless-stopped}"

EVENTFUL = """
import signal, sys, time
name, path = sys.argv[1:]
def say(word):
    with open(path, "a") as file:
        file.write(f"{word} {name}\\n")
def stop(*_):
    say("stop")
    sys.exit(0)
signal.signal(signal.SIGTERM, stop)
say("start")
print("hello from", name, flush=True)
while True:
    time.sleep(1)
"""


@pytest.fixture
def toy(tmp_path: Path) -> Iterator[Stack]:
    """A stack with a run folder and an environment of its own, not started."""
    with reserved_instance(vehicle=f"l{os.getpid()}") as instance:
        run_dir = tmp_path / "run"
        environment = {**os.environ, **instance_environment(instance), "JEZERO_RUN_DIR": str(run_dir)}
        stack = Stack(instance, run_dir, environment)
        yield stack
        stack.jezero("down", check=False)


def compose_file(tmp_path: Path, services: str) -> str:
    path = tmp_path / "compose.yaml"
    path.write_text(f"services:\n{services}")
    return str(path)


def rows(stack: Stack) -> dict[str, dict[str, Any]]:
    return {row["service"]: row for row in json.loads(stack.jezero("ps", "--json").stdout)}


def launcher_of(stack: Stack) -> int:
    return int(json.loads((stack.run_dir / "state.json").read_text())["launcher_pid"])


def all_gone(processes: list[int]) -> Callable[[], bool]:
    return lambda: all(start_ticks(pid) is None for pid in processes)


def eventful(tmp_path: Path, services: dict[str, str]) -> tuple[str, Path]:
    """Compose file of services that write their start and stop to one file; returns both paths.

    Args:
        services: by name, the services that each depends on, in YAML.
    """
    script, events = tmp_path / "eventful.py", tmp_path / "events"
    script.write_text(EVENTFUL)
    text = "".join(
        f"  {name}:\n    command: python {script} {name} {events}\n    depends_on: {depends_on}\n"
        for name, depends_on in services.items()
    )
    return compose_file(tmp_path, text), events


def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def test_services_stop_in_reverse_order_and_print_into_logs(toy: Stack, tmp_path: Path) -> None:
    file, events = eventful(tmp_path, {"late": "[middle]", "middle": "[early]", "early": "[]"})
    toy.jezero("up", "-d", "-f", file)
    wait_for(lambda: len(lines_of(events)) == 3, STARTS_WITHIN_S, "all started")
    processes = [row["pid"] for row in rows(toy).values()]
    assert [row["state"] for row in rows(toy).values()] == ["running"] * 3
    hellos = {"early  | hello from early", "late   | hello from late"}
    wait_for(lambda: hellos <= set(toy.jezero("logs").stdout.splitlines()), STARTS_WITHIN_S, "all in the logs")
    assert "hello from late" not in toy.jezero("logs", "early").stdout
    toy.jezero("down")
    assert all_gone(processes)()
    assert lines_of(events)[3:] == ["stop late", "stop middle", "stop early"]
    assert rows(toy) == {}
    assert "nothing runs" in toy.jezero("down").stdout
    assert "hello from late" in toy.jezero("logs", "-n", "100").stdout  # also of a run that is over


def test_a_stack_of_another_run_folder_is_named_with_the_command_that_looks_there(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, "  first: {command: sleep 1000}\n")
    toy.jezero("up", "-d", "-f", file)
    vehicle, other = toy.instance.vehicle, str(tmp_path / "other")
    named = f"vehicle {vehicle} runs in {toy.run_dir}: `jezero {{}} --run-dir {toy.run_dir}`"
    for command in ("ps", "down"):
        shown = toy.jezero(command, "--run-dir", other).stdout.splitlines()
        assert shown[0] == f"nothing runs in {other}" and named.format(command) in shown[1:]
    assert named.format("ps") in toy.jezero("ps", "--json", "--run-dir", other).stderr
    assert named.format("logs") in toy.jezero("logs", "--run-dir", other).stderr
    assert named.format("logs") in toy.jezero("logs", "first", "--run-dir", other, check=False).stderr
    status = toy.jezero("status", "--router", "tcp/127.0.0.1:1", check=False)
    where = f"vehicle {vehicle} runs in {toy.run_dir}: add --vehicle {vehicle} --router {toy.instance.router}"
    assert status.returncode != 0 and where in status.stderr.splitlines()
    assert rows(toy)["first"]["state"] == "running"  # `down` has not stopped it
    assert named.format("ps") not in toy.jezero("ps").stdout


@pytest.mark.long
def test_a_service_waits_until_its_dependencies_are_healthy(toy: Stack, tmp_path: Path) -> None:
    health = "healthcheck: {test: [NEVER RUN]}"
    file = compose_file(
        tmp_path,
        f"  router: {{command: python -m jezero.runtime.router, {health}}}\n"
        f"  mute: {{command: sleep 1000, {health}}}\n"
        "  first: {command: sleep 1000, depends_on: {router: {condition: service_healthy}}}\n"
        "  second: {command: sleep 1000, depends_on: {mute: {condition: service_healthy}}}\n",
    )
    failed = toy.jezero("up", "--wait", "--timeout", "8", "-f", file, check=False)
    assert failed.returncode == 1
    assert "not ready after 8 s: mute is running: no health report on the bus" in failed.stderr
    shown = rows(toy)
    assert (shown["router"]["healthy"], shown["router"]["health"]) == (True, "ok")
    assert shown["first"]["state"] == "running"
    assert (shown["second"]["state"], shown["second"]["text"]) == ("waiting", "waits for mute to be healthy")
    assert toy.jezero("ps", "--healthy", "router").stdout == ""
    assert toy.jezero("ps", "--healthy", "mute", check=False).returncode == 1


def test_a_second_up_on_the_same_run_is_refused_with_the_process_and_the_folder(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, f"  a: {SLEEPER}\n")
    toy.jezero("up", "-d", "-f", file)
    second = toy.jezero("up", "-d", "-f", file, check=False)
    assert second.returncode == 3
    assert f"process {launcher_of(toy)} runs in {toy.run_dir}" in second.stderr
    assert rows(toy)["a"]["state"] == "running"


def test_a_fence_that_was_set_in_the_run_before_is_gone(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, f"  a: {SLEEPER}\n")
    kept = toy.run_dir / KEPT_FENCE
    toy.jezero("up", "-d", "-f", file)
    kept.write_text("{}")
    toy.jezero("down")
    toy.jezero("up", "-d", "-f", file)
    assert not kept.exists()


def test_when_the_launcher_is_killed_no_child_is_alive_a_second_later(toy: Stack, tmp_path: Path) -> None:
    stubborn = 'python -c "import signal,time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(1000)"'
    file = compose_file(
        tmp_path,
        f"  a: {SLEEPER}\n  b: {SLEEPER}\n  stubborn:\n    stop_grace_period: 200ms\n    command: {stubborn}\n",
    )
    toy.jezero("up", "--wait", "-f", file)
    processes = [row["pid"] for row in rows(toy).values()]
    os.kill(launcher_of(toy), signal.SIGKILL)
    wait_for(all_gone(processes), 1.0, "children gone")
    assert rows(toy) == {}
    toy.jezero("up", "--wait", "-f", file)  # the folder is free again
    assert rows(toy)["a"]["state"] == "running"


def test_a_killed_service_comes_back_and_one_that_must_not_does_not(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, f'  a: {SLEEPER}\n  once: {{command: sleep 1000, restart: "no"}}\n')
    toy.jezero("up", "--wait", "-f", file)
    before = rows(toy)
    for row in before.values():
        os.kill(row["pid"], signal.SIGKILL)
    wait_for(lambda: rows(toy)["a"]["pid"] not in {None, before["a"]["pid"]}, 5.0, "started again")
    after = rows(toy)
    assert (after["a"]["restarts"], after["a"]["exit_code"]) == (1, -9)
    assert (after["once"]["state"], after["once"]["text"]) == ("failed", "ended with SIGKILL")
    assert "[launcher] ended with SIGKILL; again in 0.2 s" in toy.jezero("logs", "a").stdout


def test_a_crash_loop_is_given_up_with_a_clear_state_and_the_others_run_on(toy: Stack, tmp_path: Path) -> None:
    events = tmp_path / "events"
    crash = f"python -c \"import sys; open('{events}', 'a').write('x\\n'); sys.exit('no such world')\""
    file = compose_file(
        tmp_path,
        f"  router: {{command: python -m jezero.runtime.router, healthcheck: {{test: [x]}}}}\n  a: {SLEEPER}\n"
        f"  broken:\n    command: {json.dumps(crash)}\n    restart: always\n    healthcheck: {{test: [x]}}\n",
    )
    failed = toy.jezero("up", "-d", "--wait", "--timeout", "60", "-f", file, check=False)
    assert failed.returncode == 1
    reason = "crash loop: ended 6 times within 60 s; last it ended with exit code 1: no such world"
    assert f"broken: {reason}" in failed.stderr
    shown = rows(toy)
    assert shown["broken"]["text"] == reason
    assert len(lines_of(events)) == 6
    assert shown["a"]["state"] == "running"
    assert "no such world" in toy.jezero("logs", "broken").stdout


def test_a_command_that_cannot_be_run_is_reported_at_once(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, f"  a: {SLEEPER}\n  absent: {{command: no-such-program}}\n")
    failed = toy.jezero("up", "-d", "--wait", "--timeout", "30", "-f", file, check=False)
    assert failed.returncode == 1
    assert "absent: cannot run no-such-program: No such file or directory" in failed.stderr


def test_a_service_that_ignores_sigterm_is_killed_after_its_grace_period(toy: Stack, tmp_path: Path) -> None:
    script = tmp_path / "stubborn.py"
    script.write_text(
        "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('ready', flush=True)\n"
        "while True:\n    time.sleep(1)\n"
    )
    file = compose_file(tmp_path, f"  a: {{command: python {script}, stop_grace_period: 500ms}}\n")
    toy.jezero("up", "--wait", "-f", file)
    wait_for(lambda: "| ready" in toy.jezero("logs").stdout, STARTS_WITHIN_S, "running")
    pid = rows(toy)["a"]["pid"]
    begin = time.monotonic()
    toy.jezero("down")
    assert 0.5 < time.monotonic() - begin < 3.0
    assert all_gone([pid])()
    assert "killed: still running after 0.5 s" in toy.jezero("logs").stdout


def test_in_the_foreground_lines_are_prefixed_and_ctrl_c_stops_all(toy: Stack, tmp_path: Path) -> None:
    file, events = eventful(tmp_path, {"a": "[]", "b": "[a]"})
    process = toy.start("up", "-f", file)
    wait_for(lambda: len(lines_of(events)) == 2, STARTS_WITHIN_S, "both started")
    processes = [row["pid"] for row in rows(toy).values()]
    process.send_signal(signal.SIGINT)
    printed, errors = process.communicate(timeout=10)
    assert (process.returncode, errors) == (0, "")
    assert "a | hello from a\n" in printed and "b | [launcher] stopped with exit code 0\n" in printed
    assert all_gone(processes)()
    assert lines_of(events)[2:] == ["stop b", "stop a"]


def test_a_second_ctrl_c_kills(toy: Stack, tmp_path: Path) -> None:
    script, ready = tmp_path / "stubborn.py", tmp_path / "ready"
    script.write_text(
        "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        f"open({str(ready)!r}, 'w').close()\nwhile True:\n    time.sleep(1)\n"
    )
    file = compose_file(tmp_path, f"  a: {{command: python {script}, stop_grace_period: 1m}}\n")
    process = toy.start("up", "-f", file)
    wait_for(ready.exists, STARTS_WITHIN_S, "started")
    process.send_signal(signal.SIGINT)
    wait_for(lambda: rows(toy)["a"]["state"] == "stopping", 5.0, "asked to stop")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=5)
    assert process.returncode == 0


def test_the_launcher_ends_with_its_services_in_the_foreground_and_reports_that_one_failed(
    toy: Stack, tmp_path: Path
) -> None:
    file = compose_file(tmp_path, '  a: {command: "true"}\n  b: {command: "false"}\n')
    done = toy.jezero("up", "-f", file, check=False)
    assert done.returncode == 1
    assert "b | [launcher] ended with exit code 1" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("up", "-f", "/no/such/file"), "/no/such/file: No such file or directory"),
        (
            ("up", "--profile", "nobody"),
            "no service has the profile nobody; there are control, estimation, ground, onboard, rover, sim",
        ),
        (("logs", "nobody"), "no log of nobody"),
    ],
)
def test_mistakes_are_explained_in_one_line(toy: Stack, words: tuple[str, ...], message: str) -> None:
    done = toy.jezero(*words, check=False)
    assert done.returncode == 1
    assert message in done.stderr and "Traceback" not in done.stderr


@pytest.mark.whole
def test_the_whole_stack_gets_ready_and_leaves_no_process_behind(stack: Stack) -> None:
    shown = rows(stack)
    assert {"router", "simulator", "autopilot", "vehicle_bridge", *topics.ACTIONS} <= set(shown)
    assert all((row["state"], row["healthy"], row["health"]) == ("running", True, "ok") for row in shown.values())
    processes = [launcher_of(stack), *(row["pid"] for row in shown.values())]
    begin = time.monotonic()
    stack.jezero("down")
    assert time.monotonic() - begin < 5.0
    assert all_gone(processes)()
    assert not [line for line in stack.jezero("logs").stdout.splitlines() if "Traceback" in line or "killed" in line]


def test_a_second_vehicle_uses_the_running_router(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(
        tmp_path,
        f"  router: {{command: python -m jezero.runtime.router, healthcheck: {{test: [x]}}}}\n  a: {SLEEPER}\n",
    )
    toy.jezero("up", "--wait", "-f", file)
    environment = {**toy.environment, "JEZERO_RUN_DIR": str(tmp_path / "second"), "JEZERO_VEHICLE": "second"}
    second = Stack(toy.instance, tmp_path / "second", environment)
    try:
        second.jezero("up", "--wait", "--timeout", "10", "-f", file)
        assert [row["state"] for row in rows(second).values()] == ["external", "running"]
    finally:
        second.jezero("down")
    assert rows(toy)["router"]["healthy"]


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="docker-compose is not installed")
def test_a_compose_implementation_accepts_the_shipped_file() -> None:
    done = subprocess.run(
        ["docker-compose", "-f", str(SHIPPED), "--profile", "sim", "--profile", "control", "config", "--services"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert {"router", "simulator", "autopilot", "vehicle_bridge", *topics.ACTIONS} <= set(done.stdout.split())


@pytest.mark.parametrize("words", [("--help",), ("takeoff", "--help"), ("up", "--help"), ("demo", "--help"), ("ps",)])
def test_commands_start_within_0_3_s_of_work(toy: Stack, words: tuple[str, ...]) -> None:
    """Compare processor time, because other tests may use the processors."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    toy.jezero(*words)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.3
