"""The pictures of docs/how-to/fly-on-mars.md and play-with-the-simulator.md: the vehicle above the rover in two worlds.

`python -m benchmarks.world_images` flies `jezero fly --fast --world mars`, and the same in the world playground, and
draws the vehicle where it was on its way down, by the simulator's truth.
"""

import argparse
import os
from math import hypot, radians
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import msgspec
import numpy as np
from PIL import Image as Pillow

from benchmarks.docs_images import IMAGES, run_jezero
from jezero.base.config import WORLD_VARIABLE, load_config
from jezero.base.frames import Vec3, add, altitude_m, quat_from_euler
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.recording import open_recording
from jezero.schemas.state import Scene, Truth
from jezero.schemas.topics import TRUTH
from jezero.services.simulator.camera.egl_renderer import EglRenderer
from jezero.services.simulator.camera.exposure import PixelNoise
from jezero.services.simulator.camera.view import view_of
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.terrain import make_terrain

SIZE_PX, FINER = (1600, 900), 2
"""Size of the picture, and how many times finer it is drawn."""
FIELD_OF_VIEW_DEG = 52.0
HEIGHT_M = 1.5
"""Height of the vehicle over the platform."""


class Eye(NamedTuple):
    """The place from which a picture is drawn, and the direction in which it looks.

    Attributes:
        from_rover_ned_m: place of the eye from the middle of the rover's platform.
        towards_deg: direction in which it looks, clockwise from north.
        pitch_deg: angle above the horizon.
    """

    from_rover_ned_m: Vec3
    towards_deg: float
    pitch_deg: float


EYES = {"mars": Eye((-4.55, -5.05, -1.9), 48.0, -8.5), "playground": Eye((-9.5, 0.5, -3.4), 10.5, -11.0)}


def moment(run: Path) -> Truth:
    """The last moment at which the vehicle is at that height over the platform."""
    found: Truth | None = None
    for entry in open_recording(run / "flight.mcap").messages(TRUTH.name):
        truth = entry.message
        up_m = altitude_m(truth.pos_uav_ned_m[2] - truth.pos_rover_ned_m[2])
        near = hypot(*(a - b for a, b in zip(truth.pos_uav_ned_m[:2], truth.pos_rover_ned_m[:2], strict=True))) < 1.0
        if near and up_m >= HEIGHT_M:
            found = truth
    assert found is not None, "no landing in this run"
    return found


def drawn(world: str, truth: Truth, eye: Eye) -> Pillow.Image:
    """The scene of a moment."""
    os.environ[WORLD_VARIABLE] = world
    simulator, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
    width_px, height_px = size_px = (FINER * SIZE_PX[0], FINER * SIZE_PX[1])
    camera = CameraMountConfig(width_px=width_px, height_px=height_px, field_of_view_deg=FIELD_OF_VIEW_DEG)
    noise = PixelNoise(0.0, np.random.default_rng(0))
    renderer = EglRenderer(simulator.terrain, msgspec.structs.replace(vehicle, camera=camera), noise)
    renderer.world.shows_uav = True
    start_ned_m: Vec3 = (0.0, 0.0, -make_terrain(simulator.terrain).height_m(0.0, 0.0))
    stand_ned_m: Vec3 = (0.0, 0.0, -vehicle.airframe.height_stand_m)
    scene = Scene(
        t_ns=truth.t_ns,
        epoch_id=truth.epoch_id,
        pos_uav_ned_m=add(add(truth.pos_uav_ned_m, start_ned_m), stand_ned_m),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=truth.q_ned_from_frd,
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
        pos_rover_ned_m=add(truth.pos_rover_ned_m, start_ned_m),
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=truth.yaw_rover_rad,
        pitch_rover_rad=truth.pitch_rover_rad,
        roll_rover_rad=truth.roll_rover_rad,
    )
    seen_from = msgspec.structs.replace(
        scene,
        pos_uav_ned_m=add(scene.pos_rover_ned_m, eye.from_rover_ned_m),
        q_ned_from_frd=quat_from_euler(0.0, 0.0, radians(eye.towards_deg)),
    )
    view = view_of(seen_from, (0.0, 0.0, 0.0), (radians(eye.pitch_deg), 0.0))
    fine = Pillow.frombytes("RGB", size_px, renderer.picture(scene, (view, view, view)))
    return fine.resize(SIZE_PX, Pillow.Resampling.LANCZOS)


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the pictures of two worlds, each from a flight in it.")
    parser.add_argument("--out", type=Path, default=IMAGES, help="folder to write to")
    arguments = parser.parse_args()
    for world, eye in EYES.items():
        with TemporaryDirectory() as run:
            run_jezero("fly", "--fast", "--world", world, "--out", run)
            drawn(world, moment(Path(run)), eye).save(arguments.out / f"{world}.jpg", quality=86)


if __name__ == "__main__":
    main()
