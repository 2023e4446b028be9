"""A rover that drives in ROS is the rover of jezero: the vehicle of the twin lands on it while it drives."""

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import cos, degrees, pi, radians, sin
from pathlib import Path
from typing import Any

import pytest
import serial

from jezero import Aborted, Refused, Vehicle
from jezero.base.frames import wrap_pi
from jezero.deploy.twin.modules import DRIVE_DEVICE, RECEIVER_DEVICE
from jezero.deploy.twin.twin import SETTINGS
from jezero.schemas.goals import LandResult
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.topics import ROVER_ODOMETRY
from jezero.schemas.units import NS_PER_S
from jezero.services.rover_driver.service import line_of
from tests.keys.rig import free_port
from tests.system.conftest import Stack, in_the_air, wait_for
from tests.system.ros.conftest import Ros
from tests.system.ros.test_bridge import running_bridge
from tests.system.ros.test_commands import Actor, an_actor
from tests.system.test_twin import FLIGHT_TIMEOUT_S, START_TIMEOUT_S, running_twin

pytestmark = [pytest.mark.slow, pytest.mark.whole, pytest.mark.timeout(1200)]
KNOT_MPS = 1852.0 / 3600.0
LANDED_TIMEOUT_S = 400.0
WITHOUT = ("no odometry for", "no measurement of the rover", "the rate of odometry", "telemetry has been missing")
OLD = re.compile(r"it is 1\d\.\d s old")
ODOMETRY, CMD_VEL = "/rover/odom", "/rover/cmd_vel"


class RosRover:
    """The twin's rover as one of ROS: what its receiver measures goes to ROS, and what ROS commands to its motors.

    Attributes:
        sent: heading, speed and yaw rate in jezero's axes of each odometry that was published in ROS.
        twists: forward speed and yaw rate of each command from ROS.
    """

    def __init__(self, folder: Path, actor: Actor) -> None:
        self.sent: list[tuple[float, float, float]] = []
        self.twists: list[tuple[float, float]] = []
        self._actor = actor
        self._receiver = serial.Serial(str(folder / RECEIVER_DEVICE), 115_200, timeout=0.2)
        self._motors = serial.Serial(str(folder / DRIVE_DEVICE), 115_200, timeout=0.2)
        self._heading_rad = 0.0
        self._publishing = threading.Lock()
        self._over = threading.Event()
        self._threads = [threading.Thread(target=run) for run in (self._measure, self._drive)]
        actor.do("subscribe", type="geometry_msgs/msg/Twist", name=CMD_VEL)
        for thread in self._threads:
            thread.start()

    def _measure(self) -> None:
        while not self._over.is_set():
            words = self._receiver.readline().decode("ascii", "replace").split(",")
            if words[0] == "$GNHDT":
                self._heading_rad = wrap_pi(radians(float(words[1])))
            elif words[0] == "$GNRMC":
                course_rad = radians(float(words[8] or 0.0))
                backwards = cos(course_rad - self._heading_rad) < 0.0
                self.publish(self._heading_rad, float(words[7]) * KNOT_MPS * (-1.0 if backwards else 1.0))

    def publish(self, yaw_rad: float, speed_mps: float, stamp_ns: int | None = None) -> None:
        """Publish odometry in ROS, in a `map` with x east."""
        yaw_rate_rps = 0.01 * len(self.sent) % 0.05
        enu_rad = pi / 2 - yaw_rad
        stamp_ns = time.time_ns() if stamp_ns is None else stamp_ns
        self.sent.append((yaw_rad, speed_mps, yaw_rate_rps))
        message = {
            "header": {"frame_id": "map", "stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}},
            "child_frame_id": "rover/base_link",
            "pose": {"pose": {"orientation": {"z": sin(enu_rad / 2), "w": cos(enu_rad / 2)}}},
            "twist": {"twist": {"linear": {"x": speed_mps}, "angular": {"z": -yaw_rate_rps}}},
        }
        with self._publishing:
            self._actor.do("publish", type="nav_msgs/msg/Odometry", name=ODOMETRY, message=message)

    def _drive(self) -> None:
        while not self._over.is_set():
            try:
                twist: dict[str, Any] = self._actor.wait(CMD_VEL, timeout_s=0.5)["message"]
            except AssertionError:
                continue
            speed_mps, turn_rps = twist["linear"]["x"], twist["angular"]["z"]
            self.twists.append((speed_mps, turn_rps))
            self._motors.write(line_of(speed_mps, -turn_rps))

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        self._receiver.close()
        self._motors.close()


@contextmanager
def ros_rover(stack: Stack, ros: Ros, folder: Path, port: int) -> Iterator[tuple[RosRover, Actor]]:
    words = ("--rover-odometry", ODOMETRY, "--rover-cmd-vel", CMD_VEL, "--rover-driver", f"127.0.0.1:{port}")
    with running_bridge(stack, ros, *words), an_actor(stack, ros) as moving, an_actor(stack, ros) as other:
        other.do("subscribe", type="std_msgs/msg/String", name=other.name("refusals"))
        rover = RosRover(folder, moving)
        try:
            yield rover, other
        finally:
            rover.close()


def test_a_rover_of_ros_is_driven_by_jezero_and_landed_on(unstarted: Stack, ros: Ros, tmp_path: Path) -> None:
    port = free_port()
    with running_twin(tmp_path):
        settings = tmp_path / "twin" / SETTINGS
        (settings / "rover_driver.toml").write_text(f'link = "udpin:127.0.0.1:{port}"\nformat = "json"\n')
        unstarted.environment |= {"JEZERO_CONFIG_DIR": str(settings)}
        unstarted.jezero("up", "-d", "--profile", "onboard", "--profile", "rover")
        with (
            ros_rover(unstarted, ros, tmp_path / "twin", port) as (rover, other),
            unstarted.connect() as uav,
        ):
            received: list[RoverOdometry] = []
            uav.subscribe(ROVER_ODOMETRY, received.append)
            wait_for(lambda: len(received) > 50, START_TIMEOUT_S, "the odometry of ROS arrives in jezero")
            for odometry in received[5:50]:
                found = (odometry.yaw_rover_rad, odometry.speed_rover_body_mps, odometry.yaw_rate_rover_rps)
                assert any(found == pytest.approx(sent, abs=1e-6) for sent in rover.sent), f"{found} was never sent"

            wait_for(lambda: is_refused_as_old(rover, other), START_TIMEOUT_S, "an old odometry is refused")
            landed = landed_on_the_driving_rover(uav)
            assert landed.completed
            assert (0.3, 0.0) in rover.twists
            wait_for(lambda: rover.twists[-1] == (0.0, 0.0), START_TIMEOUT_S, "the rover stands at the end")
            assert max(odometry.speed_rover_body_mps for odometry in received) == pytest.approx(0.3, abs=0.1)
            print(f"landed at {landed.touchdown_ned_m}, heading {degrees(received[-1].yaw_rover_rad):.0f} degrees")


def is_refused_as_old(rover: RosRover, other: Actor) -> bool:
    """Publish an old odometry; whether that was refused soon: of refusals in two seconds ROS gets the first one."""

    def is_old(event: dict[str, Any]) -> bool:
        return OLD.search(event["message"]["data"]) is not None

    rover.publish(1.0, 0.0, time.time_ns() - 10 * NS_PER_S)
    with suppress(AssertionError):
        other.wait(other.name("refusals"), is_old, 1.0)
        return True
    return False


def landed_on_the_driving_rover(uav: Vehicle) -> LandResult:
    """Take off and land while the rover drives; again when the vehicle has gone without measurements.

    Real processes do so on a busy machine, and the vehicle is right to abort its goal then.
    """
    deadline_s = time.monotonic() + LANDED_TIMEOUT_S
    while True:
        try:
            in_the_air(uav, FLIGHT_TIMEOUT_S)
            with uav.rover.driving(0.3):
                return uav.land_on_spot(use_tag=False).result(FLIGHT_TIMEOUT_S)
        except (Aborted, Refused) as error:
            print(error)
            if not any(text in str(error) for text in WITHOUT) or time.monotonic() > deadline_s:
                raise
