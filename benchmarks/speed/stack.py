"""Whole stacks of real processes for the benchmarks, and their processor time and memory."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from msgspec.structs import replace

from jezero.deploy.launcher.ports import instance_environment
from jezero.deploy.launcher.state import RunFolder
from jezero.runtime.instance import Instance, socket_of

ROOT = Path(__file__).resolve().parents[2]
JEZERO = (sys.executable, "-m", "jezero.cli.main")
READY_WITHIN_S = 60
HOVER_ALTITUDE_M = 3.0


@dataclass(frozen=True)
class Stack:
    """A running stack.

    Attributes:
        instance: its instance.
        folder: its run folder.
        ready_s: duration of its start.
    """

    instance: Instance
    folder: Path
    ready_s: float

    def processes(self) -> dict[str, int]:
        """Process id of the launcher and of each running service."""
        state = RunFolder(self.folder).read()
        if state is None:
            raise RuntimeError(f"the launcher in {self.folder} has ended: {_log(self.folder)}")
        return {"launcher": state.launcher_pid, **{s.service: s.pid for s in state.services if s.pid is not None}}


def compose_file(folder: Path, *, without: Sequence[str], commands: Mapping[str, str] | None = None) -> Path:
    """Write the shipped compose file without some services, and with other commands for some; returns its path.

    Raises:
        RuntimeError: the shipped file has no such service.
    """
    document = yaml.safe_load((ROOT / "deploy" / "compose.yaml").read_text(encoding="utf-8"))
    services: dict[str, Any] = document["services"]
    commands = commands or {}
    unknown = {*without, *commands} - set(services)
    if unknown:
        raise RuntimeError(f"the shipped compose file has no service {sorted(unknown)}")
    for name, command in commands.items():
        services[name]["command"] = command
    kept = {name: service for name, service in services.items() if name not in without}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "compose.yaml"
    path.write_text(yaml.safe_dump({"services": kept}), encoding="utf-8")
    return path


def _log(folder: Path) -> str:
    log = folder / "logs" / "launcher.log"
    return log.read_text(errors="replace").strip() if log.exists() else "no output"


def environment_of(instance: Instance) -> dict[str, str]:
    """Environment variables of a process of a stack, with the benchmarks on the module path."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, **instance_environment(instance), "PYTHONPATH": os.pathsep.join(paths)}


@contextmanager
def running_stack(instance: Instance, folder: Path, *words: str, settings: Path | None = None) -> Iterator[Stack]:
    """Run `jezero up --wait` with extra words, and `jezero down` at the end.

    Args:
        settings: folder of the configuration files, the shipped one by default.

    Raises:
        RuntimeError: the stack doesn't get ready; the text is the command's output.
    """
    environment = {**environment_of(instance), "JEZERO_RUN_DIR": str(folder)}
    if settings is not None:
        environment["JEZERO_CONFIG_DIR"] = str(settings)
    begin_s = time.monotonic()
    try:
        up = subprocess.run(
            [*JEZERO, "up", "--wait", "--timeout", str(READY_WITHIN_S), *words],
            env=environment,
            capture_output=True,
            text=True,
            timeout=READY_WITHIN_S + 30,
            check=False,
        )
        if up.returncode != 0:
            raise RuntimeError(f"jezero up: {up.stdout}{up.stderr}")
        yield Stack(instance, folder, time.monotonic() - begin_s)
    finally:
        subprocess.run([*JEZERO, "down"], env=environment, capture_output=True, timeout=60, check=False)


@contextmanager
def running_twin(folder: Path, settings: Path, baud: int) -> Iterator["subprocess.Popen[str]"]:
    """Run `jezero twin` until the context ends.

    Args:
        folder: of the twin; its settings for the stack that flies it are in `twin.SETTINGS` there.
        settings: of the simulated world.
        baud: that of the flight controller's line.

    Raises:
        RuntimeError: the twin doesn't start.
    """
    environment = {**os.environ, "JEZERO_CONFIG_DIR": str(settings)}
    words = [*JEZERO, "twin", "--folder", str(folder), "--baud", str(baud)]
    with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            if not any("fly it with" in line for line in iter(process.stdout.readline, "")):
                raise RuntimeError("the twin has ended")
            yield process
        finally:
            process.terminate()


@contextmanager
def running_router(instance: Instance, folder: Path) -> Iterator[tuple[int, Instance]]:
    """Run a router alone.

    Args:
        folder: its run folder.

    Returns:
        Its process id, and the instance of its services.
    """
    environment = {**environment_of(instance), "JEZERO_RUN_DIR": str(folder)}
    process = subprocess.Popen([sys.executable, "-m", "jezero.runtime.router"], env=environment)
    try:
        yield process.pid, replace(instance, router=socket_of(folder))
    finally:
        process.terminate()
        process.wait(timeout=10)


@contextmanager
def running_module(module: str, *words: str, instance: Instance) -> Iterator["subprocess.Popen[str]"]:
    """Run `python -m <module> <words>` as part of a stack, and stop it at the end. The caller reads its output.

    Args:
        instance: its `router` is the address by which the process reaches the router.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", module, *words], env=environment_of(instance), stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def cpu_ns(pid: int) -> int:
    """Processor time of a process so far. Source: clock_gettime(2), the clock of another process."""
    return time.clock_gettime_ns((~pid << 3) | 2)


def memory_mb(pid: int) -> tuple[float, float]:
    """Resident memory of a process in MB: all pages, and with shared pages divided among their users."""
    fields = dict.fromkeys(("Rss", "Pss"), 0.0)
    for row in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]:
        name, value = row.split()[:2]
        if name[:-1] in fields:
            fields[name[:-1]] = int(value) * 1024 / 1e6
    return fields["Rss"], fields["Pss"]


def wait_for(condition: Callable[[], bool], timeout_s: float, description: str) -> None:
    """Poll until a condition holds.

    Raises:
        RuntimeError: the condition did not hold in time.
    """
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"{description}: not within {timeout_s:g} s")
        time.sleep(0.01)


def percentile(values: Sequence[float], fraction: float) -> float:
    """Value that a fraction of the values doesn't exceed; NaN without values."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(fraction * len(ordered)))] if ordered else float("nan")
