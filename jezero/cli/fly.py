"""`jezero fly`: a whole mission, on a running stack or in virtual time."""

import json
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.exit_codes import ABORTED
from jezero.cli.pictures import take_pictures
from jezero.cli.plan import as_planned, show_plan
from jezero.cli.shared import Printer, common_options, connected, fly_goal
from jezero.private_files import keep_private

if TYPE_CHECKING:
    from jezero.client import Vehicle
    from jezero.trials.flight import CapturedImages
    from jezero.trials.missions import Mission

RECORDED_AFTER_FLIGHT_S = 0.5


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
    with connected(vehicle, router, printer) as uav:
        if out is None:
            _fly_flight(printer, uav)
        else:
            out.mkdir(parents=True, exist_ok=True)
            with recorded(vehicle, router, out / RECORDING):
                _fly_flight(printer, uav)
            draw(printer, out)


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


def _fly_flight(printer: Printer, uav: "Vehicle") -> None:
    from jezero.trials.missions import FLIGHT

    fly_mission(printer, uav, FLIGHT, Path())


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

    from jezero.recording.about import about
    from jezero.recording.channels import keys_without_images
    from jezero.recording.viewer_scene import ViewerScene
    from jezero.recording.writer import RecordingWriter
    from jezero.runtime.config import load_config
    from jezero.schemas.topics import key
    from jezero.vehicle_config import VehicleConfig
    from jezero.zenoh_client import client_config

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
