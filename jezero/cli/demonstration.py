"""The commands of the section "Demonstration": whole missions, by a running stack or in virtual time.

`jezero fly` flies a running stack; `jezero demo` starts one, flies it, and stops it. With --fast both need none.
"""

import json
import math
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from jezero.base.files import keep_private
from jezero.cli.goals import as_planned, fly_goal, show_plan, take_pictures
from jezero.cli.options import common_options, world_option
from jezero.cli.survey import map_pictures
from jezero.cli.terminal import ABORTED, Printer, connected

if TYPE_CHECKING:
    from jezero.client import Vehicle
    from jezero.trials.flight import CapturedImages
    from jezero.trials.missions import Mission

RECORDED_AFTER_FLIGHT_S = 0.5
READY_TIMEOUT_S = 60.0


@click.command()
@click.option("--fast", is_flag=True, help="Fly in virtual time; needs no running stack.")
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="Seed, with --fast.",
)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Write recording and figures into this folder."
)
@world_option
@common_options
def fly(fast: bool, seed: int, out: Path | None, vehicle: str, router: str, as_json: bool) -> None:
    """Take off, fly to (-1, -2, -3), hover, climb, and land on the rover."""
    from jezero.recording.writer import RECORDING
    from jezero.trials.missions import FLIGHT

    printer = Printer(as_json)
    keep_private()
    if fast:
        fly_fast(printer, FLIGHT, seed, out)
        return
    if click.get_current_context().get_parameter_source("world") is ParameterSource.COMMANDLINE:
        raise click.UsageError("--world needs --fast: a running stack has its world from `jezero up --world`")
    with connected(vehicle, router, printer) as uav:
        if out is None:
            fly_mission(printer, uav, FLIGHT, Path())
        else:
            out.mkdir(parents=True, exist_ok=True)
            with recorded(vehicle, router, out / RECORDING):
                fly_mission(printer, uav, FLIGHT, Path())
            draw(printer, out)


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
@world_option
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
        _fly_own_stack(printer, folder)
        draw(printer, folder)
    map_pictures(printer, folder / AREA_COVERAGE.name)
    printer.event("done", f"recording, images, map and figures are in {folder}/", folder=str(folder))


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


def _fly_own_stack(printer: Printer, folder: Path) -> None:
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


@contextmanager
def pointing_to(printer: Printer, folder: Path) -> Iterator[None]:
    """Print where the logs are if the flight fails."""
    try:
        yield
    except SystemExit:
        text = f"the recording and each service's output are in {folder}/; `jezero report {folder}` draws the recording"
        printer.event("failed", text, folder=str(folder))
        raise


def fly_mission(printer: Printer, uav: "Vehicle", mission: "Mission", folder: Path) -> None:
    """Fly a mission on a running stack; images go into folders with the actions' names.

    Each goal's plan is shown before the goal is sent: it begins where the goal before has ended.
    """
    from jezero.client.dataset import Dataset
    from jezero.client.images import ImagesGoal

    for action, goal, hover_s in mission:
        plan = uav.plan(action, goal)
        show_plan(printer, plan, action.name)
        sent = uav.send(action, as_planned(goal, plan))
        if isinstance(sent, ImagesGoal):
            take_pictures(printer, sent, action.name, Dataset(folder / action.name, **_planned(goal)))
        else:
            fly_goal(printer, sent, action.name)
        if hover_s:
            printer.event("hover", f"hovering for {hover_s:.0f} s", seconds=hover_s)
            time.sleep(hover_s)


def fly_fast(printer: Printer, mission: "Mission", seed: int, out: Path | None) -> None:
    """Fly a mission in virtual time and write recording, images and figures into a folder, if one is given.

    Raises:
        SystemExit: the mission failed.
    """
    import msgspec

    from jezero.recording.writer import RECORDING
    from jezero.trials.flight import fly_virtually

    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    recording = None if out is None else out / RECORDING

    def on_progress(text: str) -> None:
        if not printer.as_json:
            click.echo(text)

    takes_images = any(action.takes_pictures for action, _, _ in mission)
    on_images = partial(_write_dataset, out) if out is not None and takes_images else None
    flight = fly_virtually(mission, seed, recording, on_progress, on_images)
    if out is not None:
        draw(printer, out, print_touchdown=False)
    if printer.as_json:
        click.echo(json.dumps(msgspec.to_builtins(flight)))
    elif flight.touchdown_error_m is not None:
        click.echo(
            f"landed {100.0 * flight.touchdown_error_m:.1f} cm from the middle of the platform after "
            f"{flight.sim_time_s:.1f} s of flight time, {flight.real_time_factor:.1f}x real time\n"
            f"messages sha256 {flight.messages_sha256}"
        )
    if flight.result != "succeeded":
        click.echo(f"failed: {flight.reason}", err=True)
        raise SystemExit(ABORTED)


def _write_dataset(out: Path, captured: "CapturedImages") -> None:
    from jezero.client.dataset import Dataset
    from jezero.client.images import Picture

    action, goal, _, track_ned_m, images = captured
    with Dataset(out / action.name, **_planned(goal)) as dataset:
        dataset.note(action=action.name, track_ned_m=track_ned_m, track_frame=goal.frame)
        for image, pixels in images:
            dataset.add(Picture(image, pixels))


def _planned(goal: Any) -> dict[str, Any]:
    """Fields of `images.json` for a goal: a coverage's goal, from which the report plans the path again."""
    from jezero.schemas.goals import AreaCoverageGoal

    return {"goal": goal} if isinstance(goal, AreaCoverageGoal) else {}


def draw(printer: Printer, folder: Path, *, print_touchdown: bool = True) -> None:
    """Draw all figures of a run into its folder."""
    from jezero.report.report import ReportError, draw_run

    try:
        files, landings = draw_run(folder)
    except ReportError as error:
        printer.event("report", str(error), files=[])
        return
    printer.event("report", "\n".join(f"wrote {path}" for path in files), files=[str(path) for path in files])
    for landing in landings:
        if print_touchdown and landing.touchdown_rover_body_m is not None:
            error_m = math.hypot(*landing.touchdown_rover_body_m)
            text = f"touched down {100.0 * error_m:.1f} cm from the middle of the platform, by the simulator's truth"
            printer.event("touchdown", text, touchdown_error_m=round(error_m, 4))


@contextmanager
def recorded(vehicle: str, router: str, path: Path) -> Iterator[None]:
    """Record the messages of a vehicle, without images, during the block and shortly after, until it is disarmed."""
    import zenoh

    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.base.zenoh_client import client_config
    from jezero.recording.about import about
    from jezero.recording.channels import keys_without_images
    from jezero.recording.viewer_scene import ViewerScene
    from jezero.recording.writer import RecordingWriter
    from jezero.schemas.topics import key

    prefix = key(vehicle, "")
    scene = ViewerScene(load_config(VehicleConfig, "vehicle"))
    lock = threading.Lock()
    origin = about(bus="zenoh", vehicle=vehicle)
    with (
        RecordingWriter(path, origin, scene=scene) as writer,
        zenoh.open(client_config(router, timeout_s=3.0)) as session,
    ):

        def on_sample(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                with lock:
                    writer.write(time.time_ns(), str(sample.key_expr)[len(prefix) :], sample.payload.to_bytes())

        keys = [prefix + name for name in keys_without_images()]
        subscribers = [session.declare_subscriber(each, on_sample) for each in keys]
        yield
        time.sleep(RECORDED_AFTER_FLIGHT_S)
        for subscriber in subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
