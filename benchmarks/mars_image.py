"""The picture of docs/how-to/fly-on-mars.md: the vehicle above the rover, from beside it.

`python -m benchmarks.mars_image [--run FOLDER]` flies `jezero fly --fast --world mars`, or takes the run in FOLDER, and
draws the vehicle where it was on its way down, by the simulator's truth.
"""

import argparse
import os
from math import cos, hypot, radians, sin
from pathlib import Path
from tempfile import TemporaryDirectory

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
AWAY_M, ABOVE_M, TOWARDS_DEG, PITCH_DEG = 6.8, 1.9, 48.0, -8.5
"""Place of the eye: its distance from the rover, its height over the platform, and where it looks."""


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


def picture(truth: Truth, simulator: SimulatorConfig, vehicle: VehicleConfig) -> Pillow.Image:
    """The scene of a moment."""
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
    )
    north, east = cos(radians(TOWARDS_DEG)), sin(radians(TOWARDS_DEG))
    eye_ned_m = add(scene.pos_rover_ned_m, (-AWAY_M * north, -AWAY_M * east, -ABOVE_M))
    eye = msgspec.structs.replace(
        scene, pos_uav_ned_m=eye_ned_m, q_ned_from_frd=quat_from_euler(0.0, 0.0, radians(TOWARDS_DEG))
    )
    view = view_of(eye, (0.0, 0.0, 0.0), (radians(PITCH_DEG), 0.0))
    fine = Pillow.frombytes("RGB", size_px, renderer.picture(scene, (view, view, view)))
    return fine.resize(SIZE_PX, Pillow.Resampling.LANCZOS)


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the picture of a flight on Mars.")
    parser.add_argument("--run", type=Path, help="folder of a flight in the world mars, instead of a new one")
    parser.add_argument("--out", type=Path, default=IMAGES / "mars.jpg", help="file to write")
    arguments = parser.parse_args()
    os.environ[WORLD_VARIABLE] = "mars"
    with TemporaryDirectory() as temporary:
        run = arguments.run or Path(temporary)
        if arguments.run is None:
            run_jezero("fly", "--fast", "--world", "mars", "--out", str(run))
        truth = moment(run)
    simulator, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
    picture(truth, simulator, vehicle).save(arguments.out, quality=86)


if __name__ == "__main__":
    main()
