"""A flight of the stack without a simulator, with PX4 as a real flight controller: it simulates its vehicle itself.

`JEZERO_PX4_DIR=<folder> python -m benchmarks.px4.sih [--link udp|udpout|pty] [--baud 921600] [--gimbal]`: PX4 in its
simulator SIH, and `jezero up --profile onboard --profile ground` with pictures of a folder in place of a camera. It
takes off, flies to a point, takes pictures on a circle and returns home. Prints a table with durations, and errors by
the vehicle's estimate and by PX4's simulated truth. `pty` is a serial line, at which PX4 has opened its own port.

The exit code is 1 when a goal failed, and the folder with all logs is kept then.
"""

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from math import degrees, hypot, nan
from pathlib import Path

import cv2
import msgspec
import numpy as np

from jezero import Vehicle
from jezero.base.config import config_directory
from jezero.base.frames import Vec3, distance, ned_from_geodetic, subtract
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.client.errors import JezeroError
from jezero.deploy.launcher.ports import HOST, instance_environment, reserved_instance
from jezero.deploy.twin.line import Line
from jezero.deploy.twin.twin import set_field
from jezero.runtime.instance import Instance
from jezero.schemas.state import Status
from jezero.services.autopilot import px4

JEZERO = (sys.executable, "-m", "jezero.cli.main")
START = Path(__file__).with_name("sih_start.sh")
MODEL = "sihsim_quadx"
TRUTH_PORT = 19410
"""UDP port, plus the instance, to which PX4 sends its simulated truth."""
PX4_SIDE_BAUD = 10_000_000
"""PX4's end of the line is as fast as it likes: the other end has the baud rate."""
TURN_S = 0.001
READY_TIMEOUT_S = 180.0
"""PX4 and the stack start with many processes at once, and PX4's estimator converges."""
GOAL_TIMEOUT_S = 180.0
PICTURES = 40
SIZE_PX = (640, 480)
ALTITUDE_M = 4.0
TARGET_NED_M = (8.0, 5.0, -6.0)
CENTER_NED_M = (14.0, 5.0, -6.0)
RADIUS_M = 5.0
IMAGES = 12


class Row(msgspec.Struct, frozen=True):
    """One goal.

    Attributes:
        name: what it was.
        time_s: from the request to the result.
        estimate_m: error of the position by the vehicle's own estimate; on the circle the largest one.
        truth_m: the same by the simulated truth, relative to the take-off point.
        height_m: vertical part of `truth_m`.
    """

    name: str
    time_s: float
    estimate_m: float
    truth_m: float
    height_m: float


class Truth:
    """The simulated truth, which only this benchmark reads.

    Attributes:
        position_deg: latitude, longitude and altitude in metres; None before the first message.
    """

    def __init__(self, port: int) -> None:
        self.position_deg: Vec3 | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, port))
        self._socket.settimeout(0.5)
        self._stopping = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        codec = MavlinkCodec(255, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)
        while not self._stopping:
            with suppress(TimeoutError):
                for message in codec.parse(self._socket.recv(65_536)):
                    if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION:
                        self.position_deg = (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)

    def close(self) -> None:
        """Stop reading."""
        self._stopping = True
        self._thread.join()
        self._socket.close()


class SerialLines:
    """Relays between the end of a line at PX4 and the end at the stack, at a baud rate."""

    def __init__(self, folder: Path, baud: int) -> None:
        self.controller, self.stack = Line(folder / "px4-line", PX4_SIDE_BAUD), Line(folder / "line", baud)
        self._stopping = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stopping:
            time.sleep(TURN_S)
            now_s = time.monotonic()
            if data := self.controller.move(now_s):
                self.stack.put(data)
            if data := self.stack.move(now_s):
                self.controller.put(data)

    def close(self) -> None:
        """Remove the devices."""
        self._stopping = True
        self._thread.join()
        self.controller.close()
        self.stack.close()


@contextmanager
def running_px4(folder: Path, instance: Instance, line: Path | None, baud: int, gimbal: bool) -> Iterator[None]:
    """Run PX4 with its own simulator; its output is `px4.log`."""
    runtime = os.environ.get("JEZERO_PX4_DIR")
    command = list(px4.command(Path(runtime) if runtime else None, instance.number))
    command[-1] = str(START)
    variables = px4.environment(VehicleConfig().battery) | {"PX4_SIM_MODEL": MODEL, "PX4_SIMULATOR": "sihsim"}
    variables["PX4_START"] = str(px4.START)
    if gimbal:
        variables["PX4_GIMBAL"] = "1"
    if line is not None:
        variables |= {"PX4_LINE": str(line), "PX4_BAUD": str(baud)}
    place = folder / "px4"
    place.mkdir()
    with (folder / "px4.log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=place, env={**os.environ, **variables}, stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        try:
            yield
            if process.poll() is not None:
                raise ChildProcessError(f"PX4 has ended by itself: {folder / 'px4.log'}")
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(10.0)
            process.kill()
            process.wait()


def write_pictures(folder: Path) -> Path:
    """Pictures of coloured noise: a driver takes equal ones for those of a camera that hangs."""
    folder.mkdir()
    random = np.random.default_rng(0)
    width_px, height_px = SIZE_PX
    for number in range(PICTURES):
        coarse = random.integers(0, 256, (height_px // 20, width_px // 20, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{number:03}.jpg"), cv2.resize(coarse, SIZE_PX, interpolation=cv2.INTER_CUBIC))
    return folder


@contextmanager
def running_stack(folder: Path, instance: Instance, link: str, gimbal: bool) -> Iterator[Vehicle]:
    """Run the stack of a vehicle's computer, and the ground station; yields a client of it."""
    settings = folder / "config"
    shutil.copytree(config_directory(), settings)
    set_field(settings / "vehicle_bridge.toml", "link", f'"{link}"')
    set_field(settings / "vehicle_bridge.toml", "system_id", str(instance.system_id))
    set_field(settings / "camera_driver.toml", "source", f'"file:{write_pictures(folder / "pictures")}"')
    if gimbal:
        set_field(settings / "vehicle.toml", "gimbal", '"mavlink"', "camera")
    with socket.create_server((HOST, 0)) as probe:
        port = probe.getsockname()[1]
    set_field(settings / "ground_station.toml", "port", str(port))
    own = {"JEZERO_CONFIG_DIR": str(settings), "JEZERO_RUN_DIR": str(folder / "run")}
    environment = {**os.environ, **instance_environment(instance), **own}
    load = (*JEZERO, "px4", "parameters", "load", "--yes", "--link", link)
    up = (*JEZERO, "up", "-d", "--profile", "onboard", "--profile", "ground")
    try:
        subprocess.run(load, env=environment, check=True, stdout=sys.stderr, timeout=READY_TIMEOUT_S)
        subprocess.run(up, env=environment, check=True, stdout=sys.stderr, timeout=READY_TIMEOUT_S)
        with Vehicle.connect(instance.vehicle, router=instance.router) as vehicle:
            yield vehicle
        subprocess.run((*JEZERO, "ps"), env=environment, check=False, stdout=sys.stderr, timeout=60.0)
    finally:
        subprocess.run((*JEZERO, "down"), env=environment, check=False, stdout=sys.stderr, timeout=60.0)


class Flight:
    """Flies the goals one after the other, and measures.

    Args:
        vehicle: ready to take off.
        truth: of the simulated vehicle.
    """

    def __init__(self, vehicle: Vehicle, truth: Truth) -> None:
        self._vehicle = vehicle
        self._truth = truth
        self.rows: list[Row] = []
        self._home_ned_m, self._home_deg = self._position(vehicle.status()), truth.position_deg

    @staticmethod
    def _position(status: Status) -> Vec3:
        if status.odometry is None:
            raise RuntimeError("the vehicle has no position")
        return status.odometry.pos_uav_ned_m

    @property
    def _true_ned_m(self) -> Vec3:
        """The vehicle's true place, in the frame in which the estimate at the start was exact."""
        if self._truth.position_deg is None or self._home_deg is None:
            raise RuntimeError(f"PX4 sends no truth to UDP port {TRUTH_PORT} + instance: was SIH built in?")
        x, y, z = ned_from_geodetic(self._truth.position_deg, self._home_deg)
        home = self._home_ned_m
        return (home[0] + x, home[1] + y, home[2] + z)

    def fly(self) -> None:
        """Fly all goals.

        Raises:
            JezeroError: a goal failed; `rows` has those before it.
        """
        vehicle, home = self._vehicle, self._home_ned_m
        start_s = time.monotonic()
        vehicle.takeoff(altitude_m=ALTITUDE_M).result(GOAL_TIMEOUT_S)
        self._add("take off to 4 m", start_s, (home[0], home[1], home[2] - ALTITUDE_M))
        start_s = time.monotonic()
        vehicle.go_to(*TARGET_NED_M).result(GOAL_TIMEOUT_S)
        self._add("go to a point 9 m away, 6 m up", start_s, TARGET_NED_M)
        self._circle()
        start_s = time.monotonic()
        vehicle.return_home().result(GOAL_TIMEOUT_S)
        self._add("return home and land", start_s, home)

    def _add(self, name: str, start_s: float, target_ned_m: Vec3) -> None:
        time_s = time.monotonic() - start_s
        time.sleep(1.0)  # the hover settles
        estimate, true = self._position(self._vehicle.status()), self._true_ned_m
        height_m = target_ned_m[2] - true[2]
        row = Row(name, time_s, distance(estimate, target_ned_m), distance(true, target_ned_m), height_m)
        self.rows.append(row)

    def _circle(self) -> None:
        """The errors are those across the circle, while it is flown."""
        errors: list[tuple[float, float, float]] = []
        start_s = time.monotonic()
        goal = self._vehicle.get_images(CENTER_NED_M, RADIUS_M, IMAGES)
        for feedback in goal.feedback():
            if 0 < feedback.taken < feedback.planned:
                estimate, true = (subtract(at, CENTER_NED_M) for at in (feedback.pos_uav_ned_m, self._true_ned_m))
                errors.append((_off_circle(estimate), _off_circle(true), -true[2]))
        images = goal.result(GOAL_TIMEOUT_S).images
        if len(images) != IMAGES:
            raise RuntimeError(f"{len(images)} images instead of {IMAGES}")
        pitch_deg = [degrees(image.pitch_camera_rad) for image in images]
        print(
            f"pitch of the camera: {min(pitch_deg):.0f} to {max(pitch_deg):.0f} degrees",
            file=sys.stderr,
        )
        estimate_m, truth_m = (max((each[i] for each in errors), default=nan) for i in (0, 1))
        height_m = max((each[2] for each in errors), key=abs, default=nan)
        name = f"circle of {RADIUS_M:g} m, {IMAGES} images"
        self.rows.append(Row(name, time.monotonic() - start_s, estimate_m, truth_m, height_m))


def _off_circle(from_center_m: Vec3) -> float:
    """Distance from the circle."""
    return hypot(hypot(from_center_m[0], from_center_m[1]) - RADIUS_M, from_center_m[2])


def fly(folder: Path, kind: str, baud: int, gimbal: bool) -> tuple[float, list[Row], str]:
    """Fly over a link.

    Returns:
        Time until the vehicle was ready, the rows, and why the flight ended before its end, or "".
    """
    with ExitStack() as stack:
        instance = stack.enter_context(reserved_instance("sih"))
        truth = Truth(TRUTH_PORT + instance.number)
        stack.callback(truth.close)
        line = None
        links = {
            "udp": f"udpin:{HOST}:{instance.bridge_port}",
            "udpout": f"udpout:{HOST}:{instance.autopilot_offboard_port}",
        }
        if kind == "pty":
            lines = SerialLines(folder, baud)
            stack.callback(lines.close)
            line, links["pty"] = lines.controller.path, f"serial:{lines.stack.path}:{baud}"
        start_s = time.monotonic()
        stack.enter_context(running_px4(folder, instance, line, baud, gimbal))
        vehicle = stack.enter_context(running_stack(folder, instance, links[kind], gimbal))
        vehicle.wait_ready(READY_TIMEOUT_S)
        ready_s = time.monotonic() - start_s
        flight = Flight(vehicle, truth)
        try:
            flight.fly()
        except (JezeroError, RuntimeError) as error:
            return ready_s, flight.rows, f"{type(error).__name__}: {error}"
        return ready_s, flight.rows, ""


def main() -> int:
    """Fly once, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--link", choices=("udp", "udpout", "pty"), default="udp")
    parser.add_argument("--baud", type=int, default=921_600, help="of the pty")
    parser.add_argument("--gimbal", action="store_true", help="the camera is on a gimbal that PX4 manages")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the stack and PX4 are ended on the way out
    folder = Path(tempfile.mkdtemp(prefix="jezero-sih-"))
    print(f"logs: {folder}", file=sys.stderr)
    ready_s, rows, failure = fly(folder, options.link, options.baud, options.gimbal)
    print(f"{options.link}: ready after {ready_s:.0f} s\n")
    print("| goal | time (s) | off, by the estimate (m) | off, by the truth (m) | of it vertical (m) |")
    print("|---|---|---|---|---|")
    for row in rows:
        print(f"| {row.name} | {row.time_s:.1f} | {row.estimate_m:.2f} | {row.truth_m:.2f} | {row.height_m:+.2f} |")
    if failure:
        print(f"\nfailed: {failure}\nlogs: {folder}")
        return 1
    shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
