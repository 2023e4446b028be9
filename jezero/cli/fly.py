"""The demonstration flight: in virtual time (`fly --fast`), on a running stack (`fly`), or all by itself (`demo`)."""

import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.exit_codes import ABORTED
from jezero.cli.flight import Printer, common_options, connected, fly_goal
from jezero.cli.mission import MISSION
from jezero.report.flight_log import LOG
from jezero.schemas.actions import GoToGoal, LandOnSpotGoal, TakeoffGoal

if TYPE_CHECKING:
    from jezero.client import Goal, Vehicle

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
@click.option("--fast", is_flag=True, help="In this process and virtual time; needs no running stack.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="World, noise and wind.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Keep the log and plots in this folder.")
@common_options
def fly(fast: bool, seed: int, out: Path | None, vehicle: str, router: str, as_json: bool) -> None:
    """Take off, fly to (-1, -2, -3), hover, climb, and land on the rover."""
    printer = Printer(as_json)
    if fast:
        _fly_fast(printer, seed, out)
        return
    with connected(vehicle, router, printer) as uav:
        if out is None:
            _fly_mission(printer, uav)
        else:
            out.mkdir(parents=True, exist_ok=True)
            with recorded(vehicle, router, out / LOG):
                _fly_mission(printer, uav)
            _draw(printer, out)


def _fly_fast(printer: Printer, seed: int, out: Path | None) -> None:
    import msgspec

    from jezero.deploy.virtual_flight import fly_virtually

    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    log = None if out is None else out / LOG

    def tell(text: str) -> None:
        if not printer.as_json:
            click.echo(text)

    flight = fly_virtually(MISSION, seed, log, tell)
    if out is not None:
        _draw(printer, out, tell_touchdown=False)
    if printer.as_json:
        click.echo(json.dumps(msgspec.to_builtins(flight)))
    elif flight.touchdown_error_m is not None:
        click.echo(
            f"landed {100.0 * flight.touchdown_error_m:.1f} cm from the middle of the platform after "
            f"{flight.sim_time_s:.1f} s of flight time, {flight.real_time_factor:.1f}x real time\n"
            f"log sha256 {flight.log_sha256}"
        )
    if flight.result != "succeeded":
        click.echo(f"failed: {flight.reason}", err=True)
        raise SystemExit(ABORTED)


def _fly_mission(printer: Printer, uav: "Vehicle") -> None:
    for action, goal, hover_s in MISSION:
        fly_goal(printer, _send(uav, goal), action.name)
        if hover_s:
            printer.event("hover", f"hovering for {hover_s:.0f} s", seconds=hover_s)
            time.sleep(hover_s)


def _send(uav: "Vehicle", goal: Any) -> "Goal[Any, Any]":
    match goal:
        case TakeoffGoal():
            return uav.takeoff(goal.altitude_m)
        case GoToGoal():
            return uav.go_to(*goal.target_ned_m)
        case LandOnSpotGoal():
            return uav.land_on_spot(goal.landing_spot_ned_m, use_uwb=goal.use_uwb, use_marker=goal.use_marker)
        case _:
            raise TypeError(f"the mission has a {type(goal).__name__}, which nobody here can send")


def _draw(printer: Printer, folder: Path, *, tell_touchdown: bool = True) -> None:
    from jezero.report.report import ReportError, draw_run

    try:
        files, landings = draw_run(folder)
    except ReportError as error:
        printer.event("report", str(error), files=[])
        return
    printer.event("report", "\n".join(f"wrote {path}" for path in files), files=[str(path) for path in files])
    for landing in landings:
        if tell_touchdown and landing.touchdown_rover_body_m is not None:
            error_m = math.hypot(*landing.touchdown_rover_body_m)
            text = f"touched down {100.0 * error_m:.1f} cm from the middle of the platform, by the simulator's truth"
            printer.event("touchdown", text, touchdown_error_m=round(error_m, 4))


@contextmanager
def recorded(vehicle: str, router: str, log: Path) -> Iterator[None]:
    """Log what is published for a vehicle, without its pictures."""
    import zenoh

    from jezero.client.session import client_config
    from jezero.report.flight_log import RECORDED, LogWriter
    from jezero.schemas.topics import key

    prefix = key(vehicle, "")
    lock = threading.Lock()
    with LogWriter(log) as writer, zenoh.open(client_config(router)) as session:

        def on_sample(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                with lock:
                    writer.write(time.time_ns(), str(sample.key_expr)[len(prefix) :], sample.payload.to_bytes())

        keys = [prefix + topic.name for topic in RECORDED] + [prefix + "health/*"]
        subscribers = [session.declare_subscriber(each, on_sample) for each in keys]
        yield
        for subscriber in subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]


@click.command()
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs"),
    show_default=True,
    help="Where the run's folder is made.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line, the result last.")
def demo(runs: Path, as_json: bool) -> None:
    """Bring a stack up, fly the demonstration, bring it down; leaves the log and plots in runs/<time>/."""
    from jezero.deploy.launcher.ports import instance_environment, reserved_instance

    printer = Printer(as_json)
    folder = new_run_folder(runs)
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
                _fly_mission(printer, uav)
    _draw(printer, folder)
    printer.event("done", f"the log, the plots and each service's output are in {folder}/", folder=str(folder))


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
