"""Landings of a whole stack of real processes, in real time, with the rendered camera.

`python -m benchmarks.quality.real_landings [--n 10] [--seed 0] [--rover drive] [--twin [--baud 921600]] [--orbit]`
brings a stack up in 3 m/s wind, takes off, flies to a random place 4 to 8 m up and up to 8 m away from the rover, lands
on it with UWB and tags, and starts again from there. A rover that drives does so from 2 s before the goal until the
touchdown, every second time backwards. With `--orbit` four pictures are taken from a circle before the landing. With
`--twin` the stack flies the twin: flight controller, camera, UWB module and rover are at the ends of lines.
Prints each touchdown error by the truth, and a summary.
"""

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from math import cos, hypot, pi, sin, sqrt
from pathlib import Path
from random import Random

import msgspec

from benchmarks.speed.stack import percentile, running_module, running_stack, running_twin, wait_for
from jezero import JezeroError, Vehicle
from jezero.base.config import config_directory
from jezero.client.session import Connection
from jezero.deploy.twin.twin import SETTINGS, VEHICLE
from jezero.runtime.instance import Instance, socket_of
from jezero.schemas.state import StatusCode, Truth
from jezero.schemas.topics import TRUTH
from jezero.trials.landing.flight import ROVER_DRIVES_BEFORE_S
from jezero.trials.landing.trial import (
    ALTITUDE_RANGE_M,
    MOTIONS,
    ROVER_DISTANCE_MAX_M,
    Conditions,
    RoverName,
)
from jezero.trials.platform import on_platform_m

TWIN_READY_WITHIN_S = 90.0
ORBIT_RADIUS_M, ORBIT_PICTURES = 2.5, 4
INSTANCE = Instance(vehicle="landings", router="tcp/127.0.0.1:7497", number=8, gcs_port=14608)
TRUTH_WITHIN_S = 1.0
STOPS_WITHIN_S = 10.0
HOVERS_WITHIN_S = 30.0


class Outcome(msgspec.Struct, frozen=True):
    """One landing; the error is None when it failed."""

    error_m: float | None
    time_s: float
    failure: str


def windy_settings(folder: Path) -> Path:
    """The shipped settings with the wind of the landing benchmark."""
    shutil.copytree(config_directory(), folder)
    path = folder / "simulator.toml"
    head, rest = path.read_text().split("[wind]\n", 1)
    _, tail = rest.split("\n\n", 1)
    conditions = Conditions(case="uwb+tag")
    wind = f"mean_mps = {conditions.wind_mps}\nfrom_deg = 250.0\nstd_gust_mps = {conditions.std_gust_mps}"
    path.write_text(f"{head}[wind]\n{wind}\n\n{tail}")
    return folder


@contextmanager
def running_world(options: argparse.Namespace, scratch: Path) -> Iterator[Connection]:
    """Run the stack, and the twin where it is wanted; gives a connection to where the truth is."""
    settings = windy_settings(scratch / "config")
    if not options.twin:
        with running_stack(INSTANCE, scratch / "run", settings=settings):
            yield Connection(INSTANCE.vehicle, INSTANCE.router, 3.0)
        return
    with running_twin(scratch / "twin", settings, options.baud):
        profiles = ("--profile", "onboard", "--profile", "rover")
        with running_stack(INSTANCE, scratch / "run", *profiles, settings=scratch / "twin" / SETTINGS):
            yield Connection(VEHICLE, socket_of(scratch / "twin" / "hardware" / "run"), 3.0)


def drive(rover: RoverName, number: int) -> AbstractContextManager[object]:
    """`jezero rover drive` as a process of its own, until the context ends."""
    speed_mps, yaw_rate_rps, _ = MOTIONS[rover]
    if speed_mps == 0.0:
        return nullcontext()
    backwards = number % 2
    words = ("rover", "drive", "--", f"{-speed_mps if backwards else speed_mps}", f"{yaw_rate_rps}")
    return running_module("jezero.cli.main", *words, instance=INSTANCE)


def truth_of(connection: Connection) -> Truth:
    """Newest truth of the simulator."""
    arrivals, undeclare = connection.subscribe(TRUTH)
    data = arrivals.take(time.monotonic() + TRUTH_WITHIN_S)
    undeclare()
    assert data is not None, "the simulator publishes no truth"
    return msgspec.json.decode(data, type=Truth)


def land_once(
    uav: Vehicle, connection: Connection, rng: Random, rover: AbstractContextManager[object], *, orbit: bool
) -> Outcome:
    """Take off, fly away from the rover, take pictures from a circle where that is wanted, and land on the rover."""
    up_m, away_m, bearing_rad = (
        rng.uniform(*ALTITUDE_RANGE_M),
        ROVER_DISTANCE_MAX_M * sqrt(rng.random()),
        rng.uniform(-pi, pi),
    )
    wait_for(lambda: hypot(*truth_of(connection).vel_rover_ned_mps) == 0.0, STOPS_WITHIN_S, "the rover stands")
    north_m, east_m, _ = truth_of(connection).pos_rover_ned_m
    uav.takeoff(altitude_m=up_m).result(60.0)
    place_ned_m = (north_m + away_m * cos(bearing_rad), east_m + away_m * sin(bearing_rad), -up_m)
    uav.go_to(*place_ned_m).result(60.0)
    if orbit:
        uav.get_images(place_ned_m, radius_m=ORBIT_RADIUS_M, num_images=ORBIT_PICTURES).result(120.0)
    with rover:
        time.sleep(0.0 if isinstance(rover, nullcontext) else ROVER_DRIVES_BEFORE_S)
        begin_s = time.monotonic()
        try:
            uav.land_on_spot().result(200.0)
        except JezeroError as error:
            return Outcome(None, time.monotonic() - begin_s, str(error))
        time_s = time.monotonic() - begin_s
        forward_m, right_m, _ = on_platform_m(truth_of(connection))
    return Outcome(hypot(forward_m, right_m), time_s, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rover", choices=list(MOTIONS), default="still")
    parser.add_argument("--twin", action="store_true", help="fly the twin")
    parser.add_argument("--baud", type=int, default=921_600, help="of the twin's flight controller's line")
    parser.add_argument("--orbit", action="store_true", help="take pictures before each landing")
    options = parser.parse_args()
    outcomes: list[Outcome] = []
    with (
        tempfile.TemporaryDirectory() as scratch,
        running_world(options, Path(scratch)) as connection,
        Vehicle.connect(INSTANCE.vehicle, router=INSTANCE.router) as uav,
    ):
        uav.wait_ready(TWIN_READY_WITHIN_S)
        for number in range(options.n):
            rng = Random(options.seed + number)
            rover = drive(options.rover, number)
            outcomes.append(land_once(uav, connection, rng, rover, orbit=options.orbit))
            print(json.dumps(msgspec.to_builtins(outcomes[-1])), flush=True)
            if outcomes[-1].failure:
                wait_for(lambda: uav.status().code == StatusCode.HOVER, HOVERS_WITHIN_S, "it hovers again")
                uav.land_on_spot().result(200.0)
        connection.close()
    errors_m = [float("inf") if o.error_m is None else o.error_m for o in outcomes]
    times_s = [o.time_s for o in outcomes]
    print(f"{sum(o.error_m is not None for o in outcomes)} of {len(outcomes)} landed")
    print(f"touchdown error: median {percentile(errors_m, 0.5):.3f}, p95 {percentile(errors_m, 0.95):.3f} m")
    print(f"time: median {percentile(times_s, 0.5):.1f} s")


if __name__ == "__main__":
    main()
