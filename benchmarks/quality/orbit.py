"""Tracking and aiming of an orbit with pictures, in virtual time, in 3 m/s mean wind with gusts of 0.6 m/s.

`python -m benchmarks.quality.orbit [--seeds N]` flies `getimages -2 0 -4 2 8` in the world, and `getimages 0 0 -4 2 8
rover` around a rover that stands and one that drives at 0.5 m/s. The camera is the simulator's own, with its axes,
exposures and delay, but its pictures are black: none is looked at here.
"""

import argparse
from collections.abc import Callable
from math import degrees, hypot, sqrt
from typing import Any

import msgspec
import numpy as np

from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.frames import (
    Vec3,
    add,
    q_frd_from_camera,
    quat_conjugate,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    subtract,
    wrap_pi,
    yaw_from_quat,
)
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.actions import Result
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import Frame, GetImagesGoal, TakeoffGoal
from jezero.schemas.images import Image
from jezero.schemas.state import Odometry, Scene, Status, Truth
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.service import CameraSimulator
from jezero.services.simulator.camera.view import CameraView
from jezero.services.simulator.config import SimulatorConfig, WindConfig
from jezero.trials.stack import RoverDriver, boot_id, service_makers, wired_bus

WIND = WindConfig(mean_mps=3.0, from_deg=250.0, std_gust_mps=0.6)
RADIUS_M = 2.0
HEIGHT_NED_M = -4.0
NUM_IMAGES = 8
CENTER_WORLD_NED_M = (-2.0, 0.0, HEIGHT_NED_M)
CENTER_ROVER_NED_M = (0.0, 0.0, HEIGHT_NED_M)
NO_TAGS = ("tag_detector",)
WATCHED: dict[str, Any] = {
    topic.name: topic for topic in (topics.ODOMETRY, topics.RELATIVE, topics.TRUTH, topics.SCENE, topics.STATUS)
}


class Black:
    """Renderer of black pictures."""

    description = "black"
    rate_max_hz = 60.0

    def __init__(self, camera: CameraMountConfig) -> None:
        self._pixels = bytes(3 * camera.width_px * camera.height_px)

    def picture(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> bytes:
        """See `Renderer`."""
        return self._pixels


class Orbiting:
    """A stack in wind whose camera takes black pictures; takes off, orbits, and records messages.

    Attributes:
        odometry: odometry of the whole flight.
        relatives: relative estimates of the whole flight.
        truths: truth of the whole flight.
        scenes: scenes by the time of their exposure.
    """

    def __init__(self, seed: int, *, rover_mps: float | None = None, wind: WindConfig = WIND) -> None:
        simulator = msgspec.structs.replace(load_config(SimulatorConfig, "simulator"), wind=wind)
        config, vehicle = load_config(CameraConfig, "camera"), load_config(VehicleConfig, "vehicle")
        makers: dict[str, Callable[[int], Service]] = service_makers(seed, simulator=simulator)
        makers["camera"] = lambda boot: CameraSimulator(config, vehicle, Black(vehicle.camera), seed)
        self.bus: MemoryBus = wired_bus(seed)
        for name, make in makers.items():
            if name not in NO_TAGS:
                self.bus.add(make(boot_id(seed, name)))
        self._driver = RoverDriver()
        self.bus.add(self._driver)
        self._rover_mps = rover_mps
        self.odometry: list[Odometry] = []
        self.relatives: list[Relative] = []
        self.truths: list[Truth] = []
        self.scenes: dict[int, Scene] = {}
        self._status: Status | None = None
        self.bus.observe(self._observe)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic not in WATCHED:
            return
        message = msgspec.json.decode(data, type=WATCHED[topic].type)
        if isinstance(message, Odometry):
            self.odometry.append(message)
        elif isinstance(message, Relative):
            self.relatives.append(message)
        elif isinstance(message, Truth):
            self.truths.append(message)
        elif isinstance(message, Scene):
            self.scenes[message.t_ns] = message
        elif isinstance(message, Status):
            self._status = message

    def fly(self, goal: GetImagesGoal) -> Result[Any]:
        """Take off and fly the orbit; returns its result.

        Raises:
            RuntimeError: a goal was refused, or did not end.
        """
        self.bus.run_for(30.0, lambda: self._status is not None and self._status.ready)
        self._end(self.bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=-HEIGHT_NED_M)))
        self._driver.speed_mps = self._rover_mps
        return self._end(self.bus.send_request(topics.GET_IMAGES.endpoint, goal))

    def _end(self, request: SentRequest) -> Result[Any]:
        self.bus.run_for(180.0, lambda: request.ended)
        last = request.replies[-1] if request.replies else None
        if not isinstance(last, Result):
            raise RuntimeError(f"no result: {last}")
        return last


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one orbit, by the vehicle's own estimate; `true_` by the truth.

    Attributes:
        radius_m: RMS error of the radius.
        height_m: RMS error of the height.
        facing_deg: RMS error of the heading towards the centre.
        aim_px: RMS distance of the target from the centre of the pictures.
        true_radius_m: `radius_m` by the truth.
        true_aim_px: `aim_px` by the truth.
        recorded_m: largest difference between a recorded position and the estimate at the exposure.
    """

    radius_m: float
    height_m: float
    facing_deg: float
    aim_px: float
    true_radius_m: float
    true_aim_px: float
    recorded_m: float


def measure(flight: Orbiting, goal: GetImagesGoal, images: tuple[Image, ...]) -> Figures:
    """Evaluate a flight from the first picture to the last one."""
    first_ns, last_ns = images[0].t_ns, images[-1].t_ns
    truths = [truth for truth in flight.truths if first_ns <= truth.t_ns <= last_ns]
    t_true = np.array([truth.t_ns for truth in flight.truths], dtype=float)

    def true_at(t_ns: float, name: str) -> Array:
        values = np.array([getattr(truth, name) for truth in flight.truths])
        return np.array([np.interp(t_ns, t_true, values[:, axis]) for axis in range(3)])

    follows = goal.frame == "rover"
    estimated = [o for o in flight.odometry if first_ns <= o.t_ns <= last_ns]
    offsets = []
    for odometry in estimated:
        pos_ned_m = odometry.pos_uav_ned_m
        if follows:
            nearest = min(flight.relatives, key=lambda relative: abs(relative.t_ns - odometry.t_ns))
            pos_ned_m = nearest.pos_uav_rel_rover_ned_m
        offsets.append(np.array(subtract(pos_ned_m, goal.center_ned_m)))
    away = np.array(offsets)
    bearings = np.arctan2(-away[:, 1], -away[:, 0])
    yaws = [yaw_from_quat(o.q_ned_from_frd) for o in estimated]
    facing = np.array([wrap_pi(yaw - bearing) for yaw, bearing in zip(yaws, bearings, strict=True)])
    true_away = np.array([_true_offset(truth, goal) for truth in truths])
    return Figures(
        radius_m=rms(np.hypot(away[:, 0], away[:, 1]) - goal.radius_m),
        height_m=rms(away[:, 2]),
        facing_deg=degrees(rms(facing)),
        aim_px=rms(np.array([aim_error_px(image, _target(flight, goal, image)) for image in images])),
        true_radius_m=rms(np.hypot(true_away[:, 0], true_away[:, 1]) - goal.radius_m),
        true_aim_px=rms(np.array([_true_aim_px(flight, goal, image) for image in images])),
        recorded_m=max(_recorded_error_m(flight, image, true_at) for image in images),
    )


def _true_offset(truth: Truth, goal: GetImagesGoal) -> Vec3:
    origin_ned_m = truth.pos_rover_ned_m if goal.frame == "rover" else (0.0, 0.0, 0.0)
    return subtract(subtract(truth.pos_uav_ned_m, origin_ned_m), goal.center_ned_m)


def _target(flight: Orbiting, goal: GetImagesGoal, image: Image) -> Vec3:
    """Target of a picture, in the frame of the picture's recorded pose."""
    target_ned_m = (goal.center_ned_m[0], goal.center_ned_m[1], goal.target_z_ned_m)
    if goal.frame == "world":
        return target_ned_m
    scene = flight.scenes[image.t_ns]
    center_of_mass_ned_m = (*image.pos_uav_ned_m[:2], image.pos_uav_ned_m[2] - VehicleConfig().airframe.height_stand_m)
    return add(add(target_ned_m, subtract(scene.pos_rover_ned_m, scene.pos_uav_ned_m)), center_of_mass_ned_m)


def aim_error_px(image: Image, target_ned_m: Vec3) -> float:
    """Distance of a point from the picture's centre, by the picture's recorded pose."""
    way_ned_m = subtract(target_ned_m, image.pos_camera_ned_m)
    right_m, down_m, ahead_m = quat_rotate(quat_conjugate(image.q_ned_from_camera), way_ned_m)
    return image.focal_px * hypot(right_m, down_m) / ahead_m


def _true_aim_px(flight: Orbiting, goal: GetImagesGoal, image: Image) -> float:
    """`aim_error_px` with the true attitude and, in the rover's frame, the true position."""
    scene = flight.scenes[image.t_ns]
    q_frd = q_frd_from_camera(image.pitch_camera_rad, image.roll_camera_rad)
    q_ned_from_camera = quat_normalize(quat_multiply(scene.q_ned_from_frd, q_frd))
    true = msgspec.structs.replace(image, q_ned_from_camera=q_ned_from_camera)
    return aim_error_px(true, _target(flight, goal, image))


def _recorded_error_m(flight: Orbiting, image: Image, true_at: Callable[[float, str], Array]) -> float:
    """Difference between a recorded position and the true one plus the estimate's error, which odometry around shows.

    The estimate's error changes slowly. So a difference shows that a position was recorded for a wrong time.
    """
    errors = [
        np.array(o.pos_uav_ned_m) - true_at(o.t_ns, "pos_uav_ned_m")
        for o in flight.odometry
        if abs(o.t_ns - image.t_ns) < 100_000_000
    ]
    true_m = true_at(image.t_ns, "pos_uav_ned_m")
    difference = np.array(image.pos_uav_ned_m) - true_m - np.mean(errors, axis=0)
    return float(np.linalg.norm(difference))


def rms(values: Array) -> float:
    """Root mean square."""
    return sqrt(float(np.mean(np.square(values))))


def orbit_goal(frame: Frame, num_images: int = NUM_IMAGES) -> GetImagesGoal:
    """The orbit of this benchmark."""
    center_ned_m = CENTER_WORLD_NED_M if frame == "world" else CENTER_ROVER_NED_M
    return GetImagesGoal(center_ned_m=center_ned_m, radius_m=RADIUS_M, num_images=num_images, frame=frame)


def main() -> None:
    parser = argparse.ArgumentParser(description="How well an orbit is flown.")
    parser.add_argument("--seeds", type=int, default=3)
    seeds = range(parser.parse_args().seeds)
    cases: tuple[tuple[str, Frame, float | None], ...] = (
        ("world", "world", None),
        ("rover, standing", "rover", None),
        ("rover, driving at 0.5 m/s", "rover", 0.5),
    )
    print("RMS         radius  height  facing   aim  true radius  true aim  recorded (max)")
    for title, frame, rover_mps in cases:
        print(title)
        for seed in seeds:
            flight, goal = Orbiting(seed, rover_mps=rover_mps), orbit_goal(frame)
            result = flight.fly(goal)
            if result.outcome != "succeeded" or result.result is None:
                print(f"  seed {seed}: {result.outcome}: {result.reason}")
                continue
            f = measure(flight, goal, result.result.images)
            flown = f"{100 * f.radius_m:5.1f}cm {100 * f.height_m:5.1f}cm {f.facing_deg:5.2f}° {f.aim_px:5.1f}px"
            true = f"{100 * f.true_radius_m:8.1f}cm {f.true_aim_px:8.1f}px {1000 * f.recorded_m:8.1f}mm"
            print(f"  seed {seed}  {flown} {true}", flush=True)


if __name__ == "__main__":
    main()
