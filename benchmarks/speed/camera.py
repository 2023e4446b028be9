"""Cost of a picture, and pictures of a running camera: `python -m benchmarks.speed.camera`."""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zenoh

from benchmarks.speed.bare import direct
from benchmarks.speed.stack import Stack, cpu_ns, percentile, running_stack
from jezero import Vehicle
from jezero.base.camera_preview import preview_of
from jezero.base.config import load_config
from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.base.zenoh_client import client_config
from jezero.deploy.launcher.ports import reserved_instance
from jezero.runtime.clock import VehicleClock
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import Clock, Scene
from jezero.schemas.topics import CAMERA, CLOCK, key
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.detections import BoardGeometry, detect
from jezero.services.simulator.camera.making import make_renderer
from jezero.services.simulator.camera.service import NoEglError
from jezero.services.simulator.camera.view import view_of
from jezero.services.simulator.config import SimulatorConfig

PICTURES = 20
MEASURE_S = 10.0
HEIGHTS_M = (2.0, 4.0)
ROVER_NED_M = (5.0, -3.0, -0.5)
Views = tuple[str, float, float, float]
VIEWS: tuple[Views, ...] = (
    ("down from 0.5 m", 0.5, -0.5 * pi, 0.1),
    ("down from 4 m", 4.0, -0.5 * pi, 0.3),
    ("down from 4 m, moving", 4.0, -0.5 * pi, 4.0),
    ("down from 10 m", 10.0, -0.5 * pi, 0.3),
    ("to the horizon", 2.0, -0.2, 0.3),
)
"""Name, height above the platform in m, pitch in rad, speed in m/s."""


class Cost(NamedTuple):
    """Processor time and wall time of one picture, in ms."""

    cpu_ms: float
    wall_ms: float


def scene_of(above_m: float, speed_mps: float) -> Scene:
    """Scene with the vehicle beside the centre of the platform, flying east."""
    return Scene(
        t_ns=0,
        epoch_id=0,
        pos_uav_ned_m=(ROVER_NED_M[0] - 0.2 * above_m, ROVER_NED_M[1], ROVER_NED_M[2] - above_m),
        vel_uav_ned_mps=(0.0, speed_mps, 0.0),
        q_ned_from_frd=quat_from_euler(0.03, -0.05, 0.4),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
        pos_rover_ned_m=ROVER_NED_M,
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=0.5,
    )


def time_of(make: Callable[[], object]) -> Cost:
    """Measure the processor time of all threads, and the median of wall time."""
    make()
    walls_ms = []
    begin_ns = time.process_time_ns()
    for _ in range(PICTURES):
        begin_s = time.perf_counter()
        make()
        walls_ms.append(1e3 * (time.perf_counter() - begin_s))
    return Cost((time.process_time_ns() - begin_ns) / 1e6 / PICTURES, percentile(walls_ms, 0.5))


def costs(kind: str) -> dict[str, Cost]:
    """Costs of all views with one renderer, of mode "projected", or of the previews of the views."""
    renderers = {"egl": "egl", "preview": "auto"}
    config = msgspec.structs.replace(load_config(CameraConfig, "camera"), renderer=renderers.get(kind, "tiny"))
    vehicle = load_config(VehicleConfig, "vehicle")
    board = BoardGeometry(vehicle.platform.board)
    terrain = load_config(SimulatorConfig, "simulator").terrain
    renderer = None if kind == "projected" else make_renderer(config, terrain, vehicle, 0)
    rng = np.random.default_rng(0)
    found = {}
    for name, above_m, pitch_rad, speed_mps in VIEWS:
        scene = scene_of(above_m, speed_mps)

        def make(scene: Scene = scene, pitch_rad: float = pitch_rad) -> Any:
            half_s, mount = 0.5 * config.exposure_s, vehicle.camera.pos_camera_frd_m
            begin, middle, end = (
                view_of(scene, mount, (pitch_rad, 0.0), ahead_s=ahead_s) for ahead_s in (-half_s, 0.0, half_s)
            )
            if renderer is None:
                return detect(board, (begin, middle, end), vehicle.camera.info(0), config.projection, rng)
            return renderer.picture(scene, (begin, middle, end))

        found[name] = time_of(partial(preview_of, _frame(make(), vehicle)) if kind == "preview" else make)
    return found


def _frame(pixels: bytes, vehicle: VehicleConfig) -> CameraFrame:
    """A camera's message with these pixels."""
    width_px, height_px = vehicle.camera.width_px, vehicle.camera.height_px
    return CameraFrame(
        t_ns=0,
        sequence=1,
        width_px=width_px,
        height_px=height_px,
        pitch_camera_rad=0.0,
        exposure_s=0.0,
        pixels=pixels,
    )


class Delivery(NamedTuple):
    """Pictures of a camera on the real bus while the vehicle hovers over the rover.

    Attributes:
        above_m: height above the rover.
        rate_hz: pictures per second.
        late_ms: median time from the middle of the exposure until a subscriber has the picture.
        late_p95_ms: 95th percentile of this time.
        cpu: processor time of the camera's process, in cores.
    """

    above_m: float
    rate_hz: float
    late_ms: float
    late_p95_ms: float
    cpu: float


def deliveries(stack: Stack) -> list[Delivery]:
    """Fly over the rover and measure at two heights."""
    instance = stack.instance
    found = []
    with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
        uav.wait_ready()
        uav.takeoff(altitude_m=HEIGHTS_M[0]).result(timeout_s=90)
        for above_m in HEIGHTS_M:
            uav.go_to(ROVER_NED_M[0], ROVER_NED_M[1], ROVER_NED_M[2] - above_m).result(timeout_s=120)
            found.append(_measure(stack, above_m))
    return found


def _measure(stack: Stack, above_m: float) -> Delivery:
    instance, clock = stack.instance, VehicleClock()
    lates_ms: list[float] = []

    def on_clock(sample: zenoh.Sample) -> None:
        message = msgspec.json.decode(sample.payload.to_bytes(), type=Clock)
        clock.update(message.t_ns, message.epoch_id, message.wall_ns, time.monotonic_ns())

    def on_picture(sample: zenoh.Sample) -> None:
        sample.payload.to_bytes()
        header = b"" if sample.attachment is None else sample.attachment.to_bytes()
        lates_ms.append((clock.now_ns(time.monotonic_ns()) - json.loads(header)["t_ns"]) / 1e6)

    with zenoh.open(client_config(instance.router)) as session:
        session.declare_subscriber(key(instance.vehicle, CLOCK.name), direct(on_clock))
        time.sleep(1.0)
        session.declare_subscriber(key(instance.vehicle, CAMERA.name), direct(on_picture))
        pid = stack.processes()["camera"]
        before_ns, begin_s = cpu_ns(pid), time.monotonic()
        time.sleep(MEASURE_S)
        spent_s = time.monotonic() - begin_s
        cpu = (cpu_ns(pid) - before_ns) / 1e9 / spent_s
    return Delivery(above_m, len(lates_ms) / spent_s, percentile(lates_ms, 0.5), percentile(lates_ms, 0.95), cpu)


def _print_deliveries() -> None:
    with (
        reserved_instance(vehicle="camera") as instance,
        tempfile.TemporaryDirectory() as folder,
        running_stack(instance, Path(folder)) as stack,
    ):
        for found in deliveries(stack):
            print(
                f"hovering {found.above_m:.0f} m over the rover: {found.rate_hz:.1f} pictures/s, "
                f"{found.late_ms:.0f} ms after the exposure (95 % within {found.late_p95_ms:.0f}), "
                f"{100.0 * found.cpu:.0f} % of a core; load {os.getloadavg()[0]:.1f}"
            )


def main() -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.speed.camera", description=__doc__)
    parser.add_argument("--no-stack", action="store_true", help="only the cost of a picture")
    arguments = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}; ms of processor / median ms of one picture")
    print(f"{'':10}" + "".join(f"{name:>24}" for name, *_ in VIEWS))
    for kind in ("egl", "tiny", "projected", "preview"):
        try:
            row = costs(kind)
        except NoEglError as error:
            print(f"{kind:10} {error}")
            continue
        print(f"{kind:10}" + "".join(f"{cost.cpu_ms:14.2f} / {cost.wall_ms:7.2f}" for cost in row.values()))
    if not arguments.no_stack:
        _print_deliveries()
    return 0


if __name__ == "__main__":
    sys.exit(main())
