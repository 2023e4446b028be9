"""The demonstration: the thesis' mission, all by itself."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from jezero.cli.flight import Printer, connected
from jezero.cli.fly import draw, fly_fast, fly_mission, recorded
from jezero.cli.mapping import map_pictures
from jezero.report.flight_log import LOG
from jezero.schemas.topics import AREA_COVERAGE
from jezero.trials.missions import DEMONSTRATION

READY_WITHIN_S = 60.0


def new_run_folder(runs: Path) -> Path:
    """`<runs>/<date and time>`, with a number behind it when that exists."""
    name = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    for attempt in range(100):
        folder = runs / (name if attempt == 0 else f"{name}-{attempt}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise click.ClickException(f"{runs} has a hundred runs of this very second")


@click.command()
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs"),
    show_default=True,
    help="Where the run's folder is made.",
)
@click.option("--fast", is_flag=True, help="In this process and virtual time.")
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="With --fast: of the world."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
def demo(runs: Path, fast: bool, seed: int, as_json: bool) -> None:
    """Bring a stack up, fly the thesis' mission, bring it down: take off, photograph the rover from all sides, map what
    is around it, land on it. Leaves log, pictures, map and figures in runs/<time>/.
    """
    printer = Printer(as_json)
    folder = new_run_folder(runs)
    if fast:
        fly_fast(printer, DEMONSTRATION, seed, folder)
    else:
        _fly(printer, folder)
        draw(printer, folder)
    map_pictures(printer, folder / AREA_COVERAGE.name)
    printer.event("done", f"everything is in {folder}/", folder=str(folder))


def _fly(printer: Printer, folder: Path) -> None:
    """The mission over real processes."""
    from jezero.deploy.launcher.ports import instance_environment, reserved_instance

    with reserved_instance() as instance:
        environment = {**os.environ, **instance_environment(instance), "JEZERO_RUN_DIR": str(folder.resolve())}
        printer.event("starting", "starting the stack ...", folder=str(folder))
        with running_stack(environment):
            printer.event("ready", "ready to fly")
            with (
                connected(instance.vehicle, instance.router, printer) as uav,
                recorded(instance.vehicle, instance.router, folder / LOG),
                pointing_to(printer, folder),
            ):
                fly_mission(printer, uav, DEMONSTRATION, folder)


@contextmanager
def pointing_to(printer: Printer, folder: Path) -> Iterator[None]:
    """When a flight fails, what it left behind tells why."""
    try:
        yield
    except SystemExit:
        text = f"the log and each service's output are in {folder}/; `jezero report {folder}` draws the log"
        printer.event("failed", text, folder=str(folder))
        raise


@contextmanager
def running_stack(environment: dict[str, str]) -> Iterator[None]:
    """`jezero up` before and `jezero down` after, whatever happens in between."""
    jezero = [sys.executable, "-m", "jezero.cli.main"]
    up = [*jezero, "up", "-d", "--wait", "--timeout", str(READY_WITHIN_S)]
    try:
        started = subprocess.run(up, env=environment, capture_output=True, text=True, check=False)
        if started.returncode != 0:
            raise click.ClickException(f"the stack did not come up:\n{started.stdout}{started.stderr}")
        yield
    finally:
        down: Any = subprocess.run([*jezero, "down"], env=environment, capture_output=True, text=True, check=False)
        if down.returncode != 0:
            click.echo(f"jezero down: {down.stderr.strip()}", err=True)
