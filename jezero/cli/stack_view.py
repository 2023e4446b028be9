"""`jezero ps` and `logs`: show the stack."""

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jezero.cli.exit_codes import FAILED
from jezero.cli.stack import exit_now, run_dir_option, run_folder

if TYPE_CHECKING:
    from jezero.deploy.launcher.state import RunState


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array.")
@click.option("--healthy", metavar="SERVICE", help="Print nothing; exit with 0 if this service is healthy, by the bus.")
@run_dir_option
def ps(as_json: bool, healthy: str | None, run_dir: Path | None) -> None:
    """Show the state and health of the services."""
    if healthy is not None:
        exit_now(0 if _is_healthy(healthy) else FAILED)
    import msgspec

    folder = run_folder(run_dir)
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
    from jezero.runtime.config import instance_from_environment

    changed = threading.Event()
    deadline_s = time.monotonic() + timeout_s
    with HealthWatcher(instance_from_environment(), changed.set) as watcher:
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
    for line in state.addresses:
        click.echo(line)


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

    folder = run_folder(run_dir)
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
