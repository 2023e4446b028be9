"""Odometry of a rover in ROS as lines of `rover_driver`, and there and back; the end of a drive."""

from math import cos, inf, nan, pi, radians, sin
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jezero.base.frames import q_enu_from_flu, quat_from_euler, wrap_pi
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.services.ros2_bridge import conversions as make
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.rover import EAST_RAD, DriveTwists, RoverReadings
from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.json_lines import OdometryLines
from jezero.services.rover_driver.motion import RoverMotion

T_NS = 20_000_000_000


def as_ros(value: Any) -> Any:
    """A message as rclpy has it."""
    return (
        SimpleNamespace(**{k: as_ros(v) for k, v in value.fields.items()}) if isinstance(value, RosMessage) else value
    )


def odometry(yaw_enu_rad: float = 0.0, speed_mps: float = 0.4, turn_rps: float = 0.1, t_ns: int = T_NS) -> Any:
    """A nav_msgs/Odometry with a heading anticlockwise from its x axis."""
    q = SimpleNamespace(x=0.0, y=0.0, z=sin(yaw_enu_rad / 2), w=cos(yaw_enu_rad / 2))
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=t_ns // 10**9, nanosec=t_ns % 10**9), frame_id="odom"),
        pose=SimpleNamespace(pose=SimpleNamespace(orientation=q), covariance=[0.0] * 36),
        twist=SimpleNamespace(
            twist=SimpleNamespace(
                linear=SimpleNamespace(x=speed_mps, y=0.0, z=0.0), angular=SimpleNamespace(x=0.0, y=0.0, z=turn_rps)
            ),
            covariance=[0.0] * 36,
        ),
    )


def read(line: bytes) -> RoverMotion:
    """What the driver reads in a line."""
    (motion,) = OdometryLines(RoverDriverConfig(format="json")).receive(line, 1)
    return motion


@pytest.mark.parametrize(
    ("yaw_enu_deg", "x_deg", "yaw_deg"),
    [
        (0.0, 90.0, 90.0),
        (90.0, 90.0, 0.0),
        (180.0, 90.0, -90.0),
        (0.0, 0.0, 0.0),
        (90.0, 0.0, -90.0),
        (30.0, 200.0, 170.0),
    ],
)
def test_the_heading_is_clockwise_from_north_and_the_rate_clockwise(
    yaw_enu_deg: float, x_deg: float, yaw_deg: float
) -> None:
    motion = read(RoverReadings(radians(x_deg)).line(odometry(radians(yaw_enu_deg)), (T_NS,)))
    assert wrap_pi(motion.yaw_rad - radians(yaw_deg)) == pytest.approx(0.0, abs=1e-9)
    assert (motion.speed_mps, motion.yaw_rate_rps) == (0.4, -0.1)


angles = st.floats(-3.1, 3.1)


@given(angles, st.floats(-2.0, 2.0), st.floats(-1.0, 1.0))
def test_odometry_of_jezero_is_the_same_after_the_way_through_ros_and_back(
    yaw: float, speed: float, rate: float
) -> None:
    sent = RoverOdometry(
        t_ns=T_NS, pos_odom_m=(1.0, 2.0), yaw_rover_rad=yaw, speed_rover_body_mps=speed, yaw_rate_rover_rps=rate
    )
    ros = as_ros(make.rover_odometry(sent, Context("uav1", VehicleConfig())))
    ros.pose.covariance, ros.twist.covariance = [0.0] * 36, [0.0] * 36
    motion = read(RoverReadings(EAST_RAD).line(ros, (T_NS,)))
    assert wrap_pi(motion.yaw_rad - yaw) == pytest.approx(0.0, abs=1e-9)
    assert (motion.speed_mps, motion.yaw_rate_rps) == (speed, rate)
    assert (motion.roll_rad, motion.pitch_rad) == pytest.approx((0.0, 0.0), abs=1e-9)


@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), angles)
def test_the_tilt_of_the_platform_is_that_of_jezeros_axes(roll: float, pitch: float, yaw: float) -> None:
    w, x, y, z = q_enu_from_flu(quat_from_euler(roll, pitch, yaw))
    message = odometry()
    message.pose.pose.orientation = SimpleNamespace(w=w, x=x, y=y, z=z)
    motion = read(RoverReadings(EAST_RAD).line(message, (T_NS,)))
    assert (motion.roll_rad, motion.pitch_rad) == pytest.approx((roll, pitch), abs=1e-9)
    assert wrap_pi(motion.yaw_rad - yaw) == pytest.approx(0.0, abs=1e-9)


def spoilt(what: str) -> Any:
    message = odometry()
    moving = message.twist.twist
    match what:
        case "nan":
            moving.linear.x = nan
        case "infinite":
            message.pose.pose.orientation.w = inf
        case "zero quaternion":
            message.pose.pose.orientation = SimpleNamespace(w=0.0, x=0.0, y=0.0, z=0.0)
        case "sideways":
            moving.linear.y = -0.5
        case "fast":
            moving.linear.x = 60.0
        case "heading":
            message.pose.covariance[35] = 1.0
        case "unknown speed":
            message.twist.covariance[0] = 1e6
        case "negative":
            message.twist.covariance[0] = -1.0
        case "nan variance":
            message.pose.covariance[35] = nan
    return message


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("nan", "NaN or infinite"),
        ("infinite", "NaN or infinite"),
        ("zero quaternion", "no unit quaternion"),
        ("sideways", "drives sideways at -0.5 m/s"),
        ("fast", "60 m/s"),
        ("heading", "its heading is known within 1 rad only; 0.5 rad is the limit"),
        ("unknown speed", "its speed is known within 1e.03 m/s only"),
        ("negative", "the variance of its speed is -1"),
        ("nan variance", "the variance of its heading is nan"),
    ],
)
def test_odometry_of_no_use_is_not_passed_on_and_the_reason_is_told(what: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        RoverReadings(EAST_RAD).line(spoilt(what), (T_NS,))


def test_odometry_is_fresh_by_vehicle_time_or_by_the_clock_and_else_not_passed_on() -> None:
    readings, wall_ns = RoverReadings(EAST_RAD), 1_800_000_000 * 10**9
    assert readings.line(odometry(t_ns=T_NS), (wall_ns, T_NS + 200_000_000))
    assert readings.line(odometry(t_ns=wall_ns), (wall_ns + 200_000_000, T_NS))
    with pytest.raises(ValueError, match=r"0\.4 s old, more than 0\.3 s"):
        readings.line(odometry(t_ns=wall_ns), (wall_ns + 400_000_000, T_NS))
    with pytest.raises(ValueError, match="ahead of both vehicle time and this computer's clock"):
        readings.line(odometry(t_ns=T_NS + 10**9), (wall_ns, T_NS))


def test_odometry_that_was_overtaken_is_not_passed_on_and_a_new_clock_is_followed() -> None:
    readings = RoverReadings(EAST_RAD)
    assert readings.line(odometry(t_ns=T_NS), (T_NS,))
    for t_ns in (T_NS, T_NS - 100_000_000):
        with pytest.raises(ValueError, match="a newer one came before it"):
            readings.line(odometry(t_ns=t_ns), (T_NS,))
    assert readings.line(odometry(t_ns=5 * 10**9), (5 * 10**9,))


def command(t_ns: int, speed_mps: float = 0.5) -> RoverCommand:
    return RoverCommand(t_ns=t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=0.2)


def test_a_drive_ends_with_stops_half_a_second_after_its_last_command_and_then_others_may_drive() -> None:
    drive = DriveTwists()
    assert not drive.stop(0.0)
    assert drive.command(command(T_NS), 1.0) == (0.5, -0.2)
    assert [drive.stop(1.0 + 0.1 * i) for i in range(12)] == [False] * 6 + [True] * 3 + [False] * 3
    assert drive.command(command(T_NS + 10**9), 3.0) == (0.5, -0.2)
    assert drive.stop(3.6)


def test_a_command_that_was_overtaken_is_left_out_and_a_new_epoch_is_followed() -> None:
    drive = DriveTwists()
    drive.command(command(T_NS), 1.0)
    assert drive.command(command(T_NS - 100_000_000), 1.1) is None
    assert drive.command(command(10**9), 1.2) == (0.5, -0.2)


def test_the_line_is_json_that_ends_with_a_newline() -> None:
    line = RoverReadings(EAST_RAD).line(odometry(pi / 2), (T_NS,))
    assert line.endswith(b"\n") and set(msgspec.json.decode(line)) == {
        "yaw_rad", "speed_mps", "yaw_rate_rps", "roll_rad", "pitch_rad",
    }  # fmt: skip
