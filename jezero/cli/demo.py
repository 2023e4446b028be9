"""`jezero demo`: starts a stack, flies the thesis' mission, and stops the stack."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from jezero.cli.fly import draw, fly_fast, fly_mission
from jezero.cli.mapping import map_pictures
from jezero.cli.shared import Printer, connected
from jezero.private_files import keep_private

READY_TIMEOUT_S = 60.0


def new_run_folder(runs: Path) -> Path:
    """Create `<runs>/<date and time>`, with a number appended if it exists."""
    name = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    for attempt in range(100):
        folder = runs / (name if attempt == 0 else f"{name}-{attempt}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise click.ClickException(f"{runs} has a hundred runs of this second already")


@click.command()
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs"),
    show_default=True,
    help="Folder in which the run's folder is created.",
)
@click.option("--fast", is_flag=True, help="Fly in virtual time, without starting a stack.")
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Seed of the world, with --fast."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line, the result last.")
def demo(runs: Path, fast: bool, seed: int, as_json: bool) -> None:
    """Start a stack, fly the thesis' mission, and stop the stack.

    The mission: take off, take images of the rover from all sides, cover the area around it, and land on it. Recording,
    images, map and figures are written to runs/<time>/.
    """
    from jezero.schemas.topics import AREA_COVERAGE
    from jezero.trials.missions import DEMONSTRATION

    printer = Printer(as_json)
    keep_private()
    folder = new_run_folder(runs)
    if fast:
        fly_fast(printer, DEMONSTRATION, seed, folder)
    else:
        _fly(printer, folder)
        draw(printer, folder)
    map_pictures(printer, folder / AREA_COVERAGE.name)
    printer.event("done", f"recording, images, map and figures are in {folder}/", folder=str(folder))


def _fly(printer: Printer, folder: Path) -> None:
    """Fly the mission on real processes."""
    from jezero.deploy.launcher.ports import instance_environment, reserved_instance
    from jezero.trials.missions import DEMONSTRATION

    with reserved_instance() as instance:
        environment = {**os.environ, **instance_environment(instance), "JEZERO_RUN_DIR": str(folder.resolve())}
        printer.event("starting", "starting the stack ...", folder=str(folder))
        with running_stack(environment) as address:
            watch = f"; watch it on {address}" if address else ""
            printer.event("ready", f"ready to fly{watch}", ground_station=address)
            with connected(instance.vehicle, instance.router, printer) as uav, pointing_to(printer, folder):
                fly_mission(printer, uav, DEMONSTRATION, folder)


@contextmanager
def pointing_to(printer: Printer, folder: Path) -> Iterator[None]:
    """Print where the logs are if the flight fails."""
    try:
        yield
    except SystemExit:
        text = f"the recording and each service's output are in {folder}/; `jezero report {folder}` draws the recording"
        printer.event("failed", text, folder=str(folder))
        raise


@contextmanager
def running_stack(environment: dict[str, str]) -> Iterator[str]:
    """Run `jezero up` before the block and `jezero down` after it, also after an error.

    The block gets the address of the ground station's pages, "" without a ground station.
    """
    jezero = [sys.executable, "-m", "jezero.cli.main"]
    up = [*jezero, "up", "-d", "--wait", "--timeout", str(READY_TIMEOUT_S)]
    try:
        started = subprocess.run(up, env=environment, capture_output=True, text=True, check=False)
        if started.returncode != 0:
            raise click.ClickException(f"the stack did not start:\n{started.stdout}{started.stderr}")
        found = re.search(r"^ground station: (\S+)", started.stdout, re.MULTILINE)
        yield found[1] if found else ""
    finally:
        down: Any = subprocess.run([*jezero, "down"], env=environment, capture_output=True, text=True, check=False)
        if down.returncode != 0:
            click.echo(f"jezero down: {down.stderr.strip()}", err=True)
