"""`jezero up`, `down`, `ps` and `logs`: start, stop and show the stack."""

import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from jezero.cli.exit_codes import FAILED, REFUSED

if TYPE_CHECKING:
    from jezero.deploy.launcher.compose import Service
    from jezero.deploy.launcher.state import RunFolder, RunState
    from jezero.runtime.config import Instance

POLL_S = 0.05
KILL_LAUNCHER_AFTER_S = 30.0


def run_dir_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option for the folder of a run's state and logs."""
    return click.option(
        "--run-dir",
        envvar="JEZERO_RUN_DIR",
        type=click.Path(path_type=Path, file_okay=False),
        help="Folder of the run's state and logs [default: ~/.local/state/jezero/<vehicle>].",
    )(command)


def _instance() -> "Instance":
    from jezero.runtime.config import ConfigError, instance_from_environment

    try:
        return instance_from_environment()
    except ConfigError as error:
        raise click.ClickException(str(error)) from error


def _folder(run_dir: Path | None) -> "RunFolder":
    from jezero.deploy.launcher.state import RunFolder, default_folder

    return RunFolder(run_dir or default_folder(_instance().vehicle))


def _shipped_compose_file() -> Path:
    from jezero import deploy

    return Path(deploy.__path__[0]).resolve() / "compose.yaml"


@click.command()
@click.option("--profile", "profiles", multiple=True, help="Only this profile (sim, estimation, control); repeatable.")
@click.option("-d", "--detach", is_flag=True, help="Run in the background; `jezero down` stops it.")
@click.option("--wait", is_flag=True, help="Return when the vehicle is ready; implies -d.")
@click.option("--timeout", "timeout_s", type=click.FloatRange(min=0), default=60.0, show_default=True, metavar="S",
              help="Longest wait of --wait, in seconds.")  # fmt: skip
@click.option("-f", "--file", "file", type=click.Path(path_type=Path, dir_okay=False),
              help="Compose file [default: the one shipped with jezero].")  # fmt: skip
@run_dir_option
def up(
    profiles: tuple[str, ...], detach: bool, wait: bool, timeout_s: float, file: Path | None, run_dir: Path | None
) -> None:
    """Start the services of the compose file as local processes, in the foreground unless -d.

    Ctrl+C stops them in reverse order; a second one kills them. No process is left, however the launcher ends.
    """
    from jezero.deploy.launcher.state import AlreadyUpError

    start_s = time.monotonic()
    instance, folder = _instance(), _folder(run_dir)
    path = (file or _shipped_compose_file()).resolve()
    services = _read_services(path, profiles)
    try:
        folder.acquire()
    except AlreadyUpError as error:
        click.echo(str(error), err=True)
        raise SystemExit(REFUSED) from error
    if not (detach or wait):
        _exit_now(_launch(services, folder, instance, path, detached=False))
    launcher = _detach(lambda: _launch(services, folder, instance, path, detached=True), folder)
    _wait_for_start(folder, launcher, start_s + timeout_s if wait else None, start_s)


def _read_services(path: Path, profiles: tuple[str, ...]) -> "dict[str, Service]":
    from jezero.deploy.launcher.compose import ComposeError, parse, select, with_actions
    from jezero.plugins import plugin_names

    try:
        services = parse(path.read_text(encoding="utf-8"), os.environ)
        return select(with_actions(services, plugin_names()), profiles)
    except (ComposeError, OSError) as error:
        raise click.ClickException(f"{path}: {error.strerror if isinstance(error, OSError) else error}") from error


def _launch(
    services: "dict[str, Service]", folder: "RunFolder", instance: "Instance", file: Path, *, detached: bool
) -> int:
    """Run the launcher in this process."""
    from jezero.deploy.launcher.health import router_is_up
    from jezero.deploy.launcher.launcher import Launcher

    os.environ["JEZERO_RUN_DIR"] = str(folder.path.absolute())  # for services that write files there
    shared = "router" in services and router_is_up(instance.router)
    launcher = Launcher(
        services,
        folder,
        instance,
        str(file),
        external=frozenset(["router"] if shared else []),
        terminal=None if detached else sys.stdout,
    )
    return launcher.run()


def _exit_now(code: int) -> NoReturn:
    """Exit without cleanup: Zenoh's threads may wait for a router that is gone."""
    with contextlib.suppress(OSError):  # the terminal is closed
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _detach(run: Callable[[], int], folder: "RunFolder") -> int:
    """Call `run` in a process with its own session that outlives this one.

    Returns:
        A file descriptor that reaches its end when that process does.
    """
    alive_read, alive_write = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    if (middle := os.fork()) != 0:
        os.close(alive_write)
        os.waitpid(middle, 0)
        return alive_read
    os.setsid()
    if os.fork() != 0:
        os._exit(0)
    os.close(alive_read)
    log = os.open(folder.logs / "launcher.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    for standard in (1, 2):
        os.dup2(log, standard)
    _exit_now(run())


def _wait_for_start(folder: "RunFolder", launcher: int, deadline_s: float | None, start_s: float) -> None:
    """Wait until the launcher has started, or, with a deadline, until the vehicle is ready.

    Raises:
        click.ClickException: the launcher ended, a service failed, or the deadline passed.
    """
    shown = ""
    while True:
        state = folder.read()
        if state is not None and deadline_s is None:
            click.echo(f"started; `jezero ps` shows the services. Run folder: {folder.path}")
            return
        if state is not None and state.ready:
            click.echo(f"ready after {time.monotonic() - start_s:.1f} s. Run folder: {folder.path}")
            return
        if state is not None and state.failures:
            raise click.ClickException(f"{'; '.join(state.failures)}\n{_hint(folder)}")
        reason = "the launcher has not started" if state is None else state.not_ready_reason
        if deadline_s is not None and time.monotonic() > deadline_s:
            raise click.ClickException(f"not ready after {deadline_s - start_s:g} s: {reason}\n{_hint(folder)}")
        if reason != shown and sys.stderr.isatty():
            click.echo(f"waiting: {reason}", err=True)
            shown = reason
        if select.select([launcher], [], [], POLL_S)[0]:
            log = (folder.logs / "launcher.log").read_text(errors="replace").strip()
            raise click.ClickException(f"the launcher ended by itself: {log or 'it printed nothing'}")


def _hint(folder: "RunFolder") -> str:
    return f"`jezero logs` shows the services' output, `jezero down` stops the rest; run folder: {folder.path}"


@click.command()
@run_dir_option
def down(run_dir: Path | None) -> None:
    """Stop the services of `jezero up`, in reverse order. Without running services it succeeds too."""
    folder = _folder(run_dir)
    state = folder.read()
    if state is None:
        click.echo(f"nothing runs in {folder.path}")
        return
    try:
        pidfd = os.pidfd_open(state.launcher_pid)
    except ProcessLookupError:
        click.echo("stopped")
        return
    if folder.read() is None:  # the launcher ended before pidfd_open, so the descriptor may be another process'
        click.echo("stopped")
        return
    signal.pidfd_send_signal(pidfd, signal.SIGTERM)
    if not select.select([pidfd], [], [], KILL_LAUNCHER_AFTER_S)[0]:
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)  # its services die with it
        select.select([pidfd], [], [], 1.0)
        click.echo(f"killed the launcher: it was still there after {KILL_LAUNCHER_AFTER_S:g} s", err=True)
        raise SystemExit(FAILED)
    click.echo("stopped")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array.")
@click.option("--healthy", metavar="SERVICE", help="Print nothing; exit with 0 if this service is healthy, by the bus.")
@run_dir_option
def ps(as_json: bool, healthy: str | None, run_dir: Path | None) -> None:
    """Show the state and health of the services."""
    if healthy is not None:
        _exit_now(0 if _is_healthy(healthy) else FAILED)
    import msgspec

    folder = _folder(run_dir)
    state = folder.read()
    if as_json:
        click.echo(msgspec.json.encode(state.services if state else []).decode())
    elif state is None:
        click.echo(f"nothing runs in {folder.path}")
    else:
        _print_table(state)


def _is_healthy(service: str, timeout_s: float = 3.0) -> bool:
    """Whether a service reports healthy on the bus; works without a launcher too, as in a container."""
    import threading

    from jezero.deploy.launcher.health import HealthWatcher

    changed = threading.Event()
    deadline_s = time.monotonic() + timeout_s
    with HealthWatcher(_instance(), changed.set) as watcher:
        while not watcher.report(service).healthy and time.monotonic() < deadline_s:
            changed.wait(deadline_s - time.monotonic())
            changed.clear()
        return watcher.report(service).healthy


def _print_table(state: "RunState") -> None:
    """Print a table, and whether the vehicle is ready."""
    rows = [("SERVICE", "STATE", "HEALTH", "PID", "UP", "RESTARTS", "")]
    for s in state.services:
        up_s = time.monotonic() - s.started_monotonic_s if s.pid and s.started_monotonic_s else None
        rows.append(
            (s.service, s.state, s.health, str(s.pid or ""), _span(up_s), str(s.restarts or ""), s.text.split("\n")[0])
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        click.echo("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())
    ready = "ready" if state.ready else f"not ready: {state.not_ready_reason}"
    click.echo(f"\nvehicle {state.vehicle} on {state.router}, launcher process {state.launcher_pid}: {ready}")


def _span(seconds: float | None) -> str:
    if seconds is None:
        return ""
    minutes, rest = divmod(int(seconds), 60)
    return f"{rest} s" if not minutes else f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h"


@click.command()
@click.argument("services", nargs=-1, metavar="[SERVICE]...")
@click.option("-f", "--follow", is_flag=True, help="Continue with new lines until the stack stops.")
@click.option("-n", "--tail", type=click.IntRange(min=0), metavar="N", help="Only the last N lines.")
@click.option("-t", "--timestamps", is_flag=True, help="Show the time of each line (UTC).")
@run_dir_option
def logs(services: tuple[str, ...], follow: bool, tail: int | None, timestamps: bool, run_dir: Path | None) -> None:
    """Show the output of the services in the present or last run, in order of time."""
    from jezero.deploy.launcher.output import STAMP_LENGTH, LogReader, Prefixer

    folder = _folder(run_dir)
    known = folder.logged()
    if unknown := [name for name in services if name not in known]:
        there = ", ".join(known) or "none"
        raise click.ClickException(f"no log of {', '.join(unknown)} in {folder.logs}; there are: {there}")
    reader = LogReader(folder, services or known)
    prefixer = Prefixer(services or known, colour=sys.stdout.isatty())
    lines = reader.read()
    if tail is not None:
        lines = lines[len(lines) - min(tail, len(lines)) :]
    try:
        while True:
            running = folder.read() is not None  # before the read, so that the launcher's last lines are read too
            for name, line in lines:
                click.echo(prefixer.line(name, line if timestamps else line[STAMP_LENGTH + 1 :]))
            if not follow or not (running or lines):
                return
            time.sleep(0.0 if lines else 0.1)
            lines = reader.read()
    except KeyboardInterrupt:
        return
