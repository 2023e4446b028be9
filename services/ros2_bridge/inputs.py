"""The conversions of ROS's messages into jezero's: what the estimator reads, from a bag of anybody. Needs no ROS.

Each input has the whole message of jezero first, which loses nothing, then messages of ROS that carry what the
estimator needs. Those have no epoch and no resets: the position in them must make no step.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any

from jezero.base.frames import (
    Vec3,
    euler_from_quat,
    ned_from_enu,
    quat_rotate,
    subtract,
)
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas import topics
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.sensors import Altimeter, RoverOdometry, Uwb, UwbRange
from jezero.schemas.state import Odometry
from jezero.schemas.struct import Payload
from jezero.services.ros2_bridge.conversions import UNKNOWN_M2
from jezero.services.ros2_bridge.exact import from_exact, type_name
from jezero.services.ros2_bridge.geometry import attitude as attitude_of
from jezero.services.ros2_bridge.geometry import flu_from_frd, time_ns
from jezero.services.ros2_bridge.rows import EXACT_ROWS, REQUESTS, exact_name

EPOCH_ID = 1
"""Epoch of messages that have none."""
ANCHOR = re.compile(r"(\d+)$")
Convert = Callable[[Any, VehicleConfig], Payload]


@dataclass(frozen=True)
class RosInput:
    """One type of messages from which an input of the estimator is made.

    Attributes:
        source: topic of jezero, or request.
        name: of the topic in ROS, below the vehicle's namespace; "" where only a mapping of topics names it.
        type: of the messages in ROS.
        convert: makes jezero's message; raises ValueError for one that is not usable.
        about: what is taken from the message, and what it can't carry.
    """

    source: Topic[Any] | Endpoint[Any, Any]
    name: str
    type: str
    convert: Convert
    about: str


def _exact(source: Topic[Any] | Endpoint[Any, Any], struct: Any, about: str) -> RosInput:
    def convert(m: Any, config: VehicleConfig) -> Payload:
        made: Payload = from_exact(struct, m)
        return made

    return RosInput(source, exact_name(source), type_name(struct), convert, about)


def odometry(m: Any, config: VehicleConfig) -> Odometry:
    """The vehicle's odometry: pose of `base_link` in a frame with x east and z up, twist in `base_link`."""
    attitude = attitude_of(m.pose.pose.orientation)
    center_enu_m = _vec3(m.pose.pose.position)
    variance_m2 = float(m.pose.covariance[0])
    return Odometry(
        t_ns=time_ns(m.header.stamp),
        epoch_id=EPOCH_ID,
        pos_uav_ned_m=ned_from_enu(subtract(center_enu_m, (0.0, 0.0, config.airframe.height_stand_m))),
        vel_uav_ned_mps=quat_rotate(attitude, flu_from_frd(_vec3(m.twist.twist.linear))),
        q_ned_from_frd=attitude,
        rates_uav_frd_rps=flu_from_frd(_vec3(m.twist.twist.angular)),
        std_pos_m=sqrt(variance_m2) if 0.0 < variance_m2 < UNKNOWN_M2 else None,
    )


def rover_odometry(m: Any, config: VehicleConfig) -> RoverOdometry:
    """The rover's odometry: its heading is that of a frame with x east."""
    roll_rad, pitch_rad, yaw_rad = euler_from_quat(attitude_of(m.pose.pose.orientation))
    return RoverOdometry(
        t_ns=time_ns(m.header.stamp),
        pos_odom_m=(float(m.pose.pose.position.y), float(m.pose.pose.position.x)),
        yaw_rover_rad=yaw_rad,
        speed_rover_body_mps=float(m.twist.twist.linear.x),
        yaw_rate_rover_rps=-float(m.twist.twist.angular.z),
        roll_rover_rad=roll_rad,
        pitch_rover_rad=pitch_rad,
    )


def altimeter(m: Any, config: VehicleConfig) -> Altimeter:
    """The altimeter's range; one beyond its limits met nothing. Source: REP 117."""
    range_m = float(m.range)
    measured = isfinite(range_m) and range_m > 0.0 and m.min_range <= range_m <= m.max_range
    return Altimeter(t_ns=time_ns(m.header.stamp), range_m=range_m if measured else None)


def single_range(m: Any, config: VehicleConfig) -> Uwb:
    """A round of one range. The frame ends in the anchor's number, whose position is that of `vehicle.toml`.

    Raises:
        ValueError: the frame names no anchor.
    """
    found, places_m = ANCHOR.search(m.header.frame_id), config.uwb.pos_anchors_rover_body_m
    number = int(found[1]) if found else len(places_m)
    if number >= len(places_m):
        raise ValueError(
            f"its frame {m.header.frame_id!r} does not end in the number of an anchor: vehicle.toml has the anchors 0 "
            f"to {len(places_m) - 1}"
        )
    t_ns, range_m = time_ns(m.header.stamp), float(m.range)
    reading = UwbRange(t_ns=t_ns, anchor=number, pos_anchor_rover_body_m=places_m[number], range_m=range_m)
    return Uwb(t_ns=t_ns, ranges=(reading,) if isfinite(range_m) else ())


def _vec3(v: Any) -> Vec3:
    return (float(v.x), float(v.y), float(v.z))


ODOMETRY, RANGE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Range"
INPUTS: tuple[RosInput, ...] = (
    *(_exact(row.source, row.source.struct, row.about) for row in EXACT_ROWS),
    *(_exact(request, request.request_type, "a request, at the time at which it arrived") for request in REQUESTS),
    _exact(topics.TRUTH, topics.TRUTH.struct, "of the simulator, or of another measurement of the poses"),
    RosInput(
        topics.ODOMETRY,
        "odometry",
        ODOMETRY,
        odometry,
        "pose of `base_link` east, north, up; twist in `base_link`; without resets of the position",
    ),
    RosInput(
        topics.ROVER_ODOMETRY,
        "rover/odometry",
        ODOMETRY,
        rover_odometry,
        "attitude of the platform in a frame with x east; speed and yaw rate",
    ),
    RosInput(topics.ALTIMETER, "altimeter", RANGE, altimeter, "range along the vehicle's down axis, in 32 bits"),
    RosInput(
        topics.UWB,
        "",
        RANGE,
        single_range,
        "one range in 32 bits; `frame_id` ends in the anchor's number, whose position `vehicle.toml` has",
    ),
)
"""Inputs, of which a bag's first one is taken for each topic of jezero."""
NEEDED: tuple[tuple[str, tuple[Topic[Any], ...]], ...] = (
    ("the vehicle's odometry", (topics.ODOMETRY,)),
    ("the rover's odometry", (topics.ROVER_ODOMETRY,)),
    ("UWB ranges or positions by the tags", (topics.UWB, topics.ESTIMATE_TAG)),
)
"""What the estimator can't do without, each from one of some topics."""
