"""The camera as a real process: its pictures are those of its renderer."""

import io
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import zenoh
from PIL import Image

from jezero.base.codec import decode, encode
from jezero.base.config import load_config
from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.base.zenoh_client import client_config, data_of
from jezero.deploy.launcher.ports import instance_environment, reserved_instance, service_environment
from jezero.runtime.instance import socket_of
from jezero.schemas import topics
from jezero.schemas.sensors import CameraFrame, CameraPreview
from jezero.schemas.state import Clock, Scene
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.making import make_renderer
from jezero.services.simulator.camera.view import view_of
from jezero.services.simulator.config import SimulatorConfig
from tests.system.conftest import wait_for

STILL = (0.0, 0.0, 0.0)


def scene(t_ns: int) -> Scene:
    """A scene with the vehicle three metres above the rover."""
    return Scene(
        t_ns=t_ns,
        epoch_id=1,
        pos_uav_ned_m=(5.2, -3.1, -3.5),
        vel_uav_ned_mps=STILL,
        q_ned_from_frd=quat_from_euler(0.0, 0.0, 0.3),
        rates_uav_frd_rps=STILL,
        pos_rover_ned_m=(5.0, -3.0, -0.5),
        vel_rover_ned_mps=STILL,
        yaw_rover_rad=0.5,
    )


def test_pictures_and_previews_of_a_real_process_equal_those_of_its_renderer(tmp_path: Path) -> None:
    frames: list[CameraFrame] = []
    previews: list[CameraPreview] = []
    with reserved_instance(vehicle=f"camera{os.getpid()}") as instance:
        service = service_environment(instance, tmp_path)
        programs = (
            ("jezero.runtime.router", {**service, **instance_environment(instance)}),
            ("jezero.services.simulator.camera", service),
        )
        processes = [
            subprocess.Popen([sys.executable, "-m", module], env={**os.environ, **variables})
            for module, variables in programs
        ]
        try:
            with zenoh.open(client_config(socket_of(tmp_path))) as session:
                camera = topics.key(instance.vehicle, topics.CAMERA.name)
                session.declare_subscriber(camera, lambda sample: frames.append(decode(CameraFrame, data_of(sample))))

                preview = topics.key(instance.vehicle, topics.CAMERA_PREVIEW.name)
                session.declare_subscriber(
                    preview, lambda sample: previews.append(decode(CameraPreview, data_of(sample)))
                )

                def shows() -> bool:
                    now_ns = time.monotonic_ns()
                    clock = Clock(t_ns=now_ns, epoch_id=1, wall_ns=now_ns)
                    session.put(topics.key(instance.vehicle, topics.CLOCK.name), encode(clock))
                    session.put(topics.key(instance.vehicle, topics.SCENE.name), encode(scene(now_ns)))
                    time.sleep(0.07)
                    return len(frames) >= 3 and len(previews) >= 2

                wait_for(shows, 60, "three pictures and two previews")
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait(timeout=10)
    config, vehicle, frame = load_config(CameraConfig, "camera"), load_config(VehicleConfig, "vehicle"), frames[-1]
    at = scene(frame.t_ns)
    view = view_of(at, vehicle.camera.pos_camera_frd_m, (frame.pitch_camera_rad, frame.roll_camera_rad))
    renderer = make_renderer(config, load_config(SimulatorConfig, "simulator").terrain, vehicle, seed=2)
    drawn = np.frombuffer(renderer.picture(at, (view, view, view)), dtype=np.uint8).astype(float)
    shown = np.frombuffer(frame.pixels, dtype=np.uint8).astype(float)
    assert drawn.std() > 30.0
    assert np.abs(shown - drawn).mean() < 10.0
    seen = next(frame for frame in frames if frame.t_ns == previews[-1].t_ns)
    with Image.open(io.BytesIO(previews[-1].jpeg)) as image:
        whole = np.asarray(image.resize((seen.width_px, seen.height_px))).astype(float)
    pixels = np.frombuffer(seen.pixels, dtype=np.uint8).reshape(whole.shape)
    assert np.abs(whole - pixels).mean() < 10.0
