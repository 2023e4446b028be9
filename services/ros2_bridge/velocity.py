"""What arrives on `cmd_vel` as a velocity command of jezero. Needs no ROS."""

from dataclasses import dataclass
from math import isfinite
from typing import Any

from jezero.schemas.units import NS_PER_S
from jezero.services.ros2_bridge.geometry import time_ns

TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""Types that `cmd_vel` may have in ROS: a topic has one of them, and Nav2 publishes the second since Kilted."""
STAMP_AGE_MAX_S = 0.5
"""A stamp that is farther from vehicle time is refused."""


@dataclass(frozen=True)
class Velocity:
    """A velocity relative to the vehicle's heading, in the words of jezero.

    Attributes:
        forward_mps: along the heading.
        right_mps: to the right.
        up_mps: upwards.
        yaw_rate_rps: clockwise as seen from above.
    """

    forward_mps: float
    right_mps: float
    up_mps: float
    yaw_rate_rps: float

    @property
    def is_zero(self) -> bool:
        return not any((self.forward_mps, self.right_mps, self.up_mps, self.yaw_rate_rps))


def velocity_from(twist: Any) -> Velocity:
    """A twist of REP 103 (x forward, y left, z up, yaw anticlockwise) as a velocity.

    Raises:
        ValueError: a number is not finite, or the twist would roll or pitch the vehicle.
    """
    linear, angular = twist.linear, twist.angular
    numbers = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    if not all(map(isfinite, numbers)):
        raise ValueError("a number of the twist is NaN or infinite")
    if angular.x or angular.y:
        raise ValueError("angular.x and angular.y roll and pitch the vehicle: expected 0, as it tilts by itself")
    return Velocity(linear.x, -linear.y, linear.z, -angular.z)


def header_refusal(header: Any, frames: tuple[str, ...], t_ns: int | None) -> str:
    """Reason why a stamped twist is not followed, or "".

    Args:
        header: of the message; a stamp of zero is none.
        frames: names that the frame may have.
        t_ns: vehicle time; None while it is unknown.
    """
    if header.frame_id and header.frame_id not in frames:
        return f"its frame is {header.frame_id!r}: expected {frames[0]}, or none"
    stamp_ns = time_ns(header.stamp)
    if stamp_ns == 0 or t_ns is None:
        return ""
    age_s = (t_ns - stamp_ns) / NS_PER_S
    if abs(age_s) <= STAMP_AGE_MAX_S:
        return ""
    return (
        f"its stamp is {abs(age_s):.1f} s {'behind' if age_s > 0 else 'ahead of'} vehicle time: run the node with "
        "use_sim_time, or leave the stamp zero"
    )
