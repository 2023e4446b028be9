"""A rover of ROS as the rover of jezero: its odometry as lines for `rover_driver`, and when it stops. Needs no ROS."""

from math import isfinite, pi, sqrt
from typing import Any

import msgspec

from jezero.base.frames import euler_from_quat, wrap_pi
from jezero.schemas.commands import RoverCommand
from jezero.schemas.units import NS_PER_S
from jezero.services.ros2_bridge.geometry import attitude, time_ns

AGE_MAX_S = 0.3
"""Greatest age of an odometry: a vehicle that lands at 1 m/s on where the rover was would miss it."""
STD_YAW_MAX_RAD, STD_SPEED_MAX_MPS = 0.5, 1.0
"""Standard deviations above which odometry is of no use for a landing."""
SIDEWAYS_MAX_MPS = 0.2
"""A rover of jezero drives along its heading; a faster drift to the side would be lost."""
SPEED_MAX_MPS, YAW_RATE_MAX_RPS = 50.0, 10.0
"""Ranges of the driver's lines."""
YAW, FORWARD = 35, 0
"""Places in a covariance of ROS: of the yaw in a pose, and of x in a twist."""
EAST_RAD = pi / 2
"""Heading of the x axis of REP 103's `map`."""
DRIVE_TIMEOUT_S = 0.5
"""The rover stops after this time without a command. Source: `RoverCommand`."""
STOPS = 3
"""Number of stops that end a drive, as one may be lost; then others may drive the rover."""


class RoverReadings:
    """Makes a line for `rover_driver` of each odometry.

    Args:
        heading_x_rad: heading of the x axis of the odometry's frame, clockwise from north; pi / 2 for a `map` by
            REP 103, whose x is east.
    """

    def __init__(self, heading_x_rad: float) -> None:
        self._heading_x_rad = heading_x_rad
        self._newest_ns = 0

    def line(self, odometry: Any, now_ns: tuple[int, ...]) -> bytes:
        """The line of a nav_msgs/Odometry, of which the twist is in the rover's own frame.

        Args:
            odometry: the message.
            now_ns: what the time is now, by each clock that the message may be stamped with.

        Raises:
            ValueError: it must not be passed on; the text is the reason.
        """
        q = odometry.pose.pose.orientation
        linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
        numbers = (q.w, q.x, q.y, q.z, linear.x, linear.y, angular.z)
        if not all(map(isfinite, numbers)):
            raise ValueError("a number of its orientation or twist is NaN or infinite")
        if refusal := self._stamp_refusal(odometry.header.stamp, now_ns) or _doubts(odometry):
            raise ValueError(refusal)
        # As if the x axis of its frame were east; then turned to where that axis points.
        roll_rad, pitch_rad, yaw_rad = euler_from_quat(attitude(q))
        reading = {
            "yaw_rad": wrap_pi(yaw_rad - wrap_pi(EAST_RAD - self._heading_x_rad)),
            "speed_mps": linear.x,
            "yaw_rate_rps": -angular.z,
            "roll_rad": roll_rad,
            "pitch_rad": pitch_rad,
        }
        return msgspec.json.encode(reading) + b"\n"

    def _stamp_refusal(self, stamp: Any, now_ns: tuple[int, ...]) -> str:
        """Reason why an odometry is too old, comes from the future, or was overtaken, or ""."""
        stamp_ns = time_ns(stamp)
        age_s = min(((now - stamp_ns) / NS_PER_S for now in now_ns), key=abs)
        if age_s > AGE_MAX_S:
            return f"it is {age_s:.1f} s old, more than {AGE_MAX_S:g} s"
        if age_s < -AGE_MAX_S:
            return f"its stamp is {-age_s:.1f} s ahead of both vehicle time and this computer's clock"
        is_late = 0 <= self._newest_ns - stamp_ns < NS_PER_S  # farther back, its clock has begun anew
        self._newest_ns = max(stamp_ns, self._newest_ns) if is_late else stamp_ns
        return "a newer one came before it" if is_late else ""


def _doubts(odometry: Any) -> str:
    """Reason why an odometry is of no use for a landing, or ""; a covariance of zeros is one that isn't given."""
    linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
    var_yaw, var_speed = odometry.pose.covariance[YAW], odometry.twist.covariance[FORWARD]
    for what, variance, std_max, unit in (
        ("heading", var_yaw, STD_YAW_MAX_RAD, "rad"),
        ("speed", var_speed, STD_SPEED_MAX_MPS, "m/s"),
    ):
        if not 0.0 <= variance < float("inf"):
            return f"the variance of its {what} is {variance:g}"
        if sqrt(variance) > std_max:
            return f"its {what} is known within {sqrt(variance):.2g} {unit} only; {std_max:g} {unit} is the limit"
    if abs(linear.y) > SIDEWAYS_MAX_MPS:
        return f"it drives sideways at {linear.y:.1f} m/s: jezero's rover drives along its heading"
    if abs(linear.x) > SPEED_MAX_MPS or abs(angular.z) > YAW_RATE_MAX_RPS:
        return (
            f"{linear.x:g} m/s and {angular.z:g} rad/s are beyond {SPEED_MAX_MPS:g} m/s and {YAW_RATE_MAX_RPS:g} rad/s"
        )
    return ""


class DriveTwists:
    """Which velocities a rover of ROS gets: the commands of jezero, then some stops, then none.

    After the stops, a planner of ROS can drive the rover again.
    """

    def __init__(self) -> None:
        self._newest_ns = 0
        self._commanded_s: float | None = None
        self._stops = 0

    def command(self, command: RoverCommand, now_s: float) -> tuple[float, float] | None:
        """Forward speed in m/s, and yaw rate in rad/s anticlockwise; None for a command that was overtaken.

        Args:
            now_s: monotonic time.
        """
        if 0 < self._newest_ns - command.t_ns < NS_PER_S:  # farther back, a new epoch has begun
            return None
        self._newest_ns, self._commanded_s, self._stops = command.t_ns, now_s, STOPS
        return command.speed_rover_body_mps, -command.yaw_rate_rover_rps

    def stop(self, now_s: float) -> bool:
        """Whether a stop is to be sent now."""
        if self._commanded_s is None or now_s - self._commanded_s <= DRIVE_TIMEOUT_S or self._stops == 0:
            return False
        self._stops -= 1
        return True
