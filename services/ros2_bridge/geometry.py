"""ROS's axes and types from jezero's: REP 103 has x forward, y left, z up, and a map with x east, y north, z up.

| jezero       | ROS                    | conversion                                  |
|--------------|------------------------|---------------------------------------------|
| `ned`        | `map`, `odom`: ENU     | (n, e, d) → (e, n, −d)                      |
| `frd`        | `base_link`: FLU       | (x, y, z) → (x, −y, −z)                     |
| yaw          | angle about z          | clockwise from north → anticlockwise from east |
| `rover_body` | `platform`: FLU        | (x, y, z) → (x, −y, −z)                     |
| `camera`     | `camera_optical`       | the same: x right, y down, z forward        |

Quaternions are (w, x, y, z) in jezero and x, y, z, w in ROS. Source: REP 103, REP 105.
"""

from collections.abc import Mapping, Sequence
from math import cos, pi, sin
from typing import Any, NamedTuple

from jezero.base.frames import Quat, Vec3, q_ned_from_frd, quat_multiply, quat_normalize
from jezero.schemas.units import NS_PER_S

FLU_FROM_FRD: Quat = (0.0, 1.0, 0.0, 0.0)
"""A half turn about the forward axis; its own inverse."""
UPRIGHT: Quat = (1.0, 0.0, 0.0, 0.0)


class RosMessage(NamedTuple):
    """A ROS message, or a part of one, without ROS: fields that are left out keep their defaults.

    Attributes:
        type: such as "nav_msgs/msg/Odometry".
        fields: values by name: numbers, strings, sequences, and other messages.
    """

    type: str
    fields: Mapping[str, Any]


def flu_from_frd(v_frd: Vec3) -> Vec3:
    """Flip the right and the down axis; its own inverse."""
    return (v_frd[0], -v_frd[1], -v_frd[2])


def q_enu_from_heading(yaw_rad: float) -> Quat:
    """Attitude in ENU of a level frame with x ahead and z up, from its heading in NED."""
    half_rad = 0.25 * pi - 0.5 * yaw_rad
    return quat_normalize((cos(half_rad), 0.0, 0.0, sin(half_rad)))


def q_flu_from_camera(q_frd_from_camera: Quat) -> Quat:
    """Attitude of the camera's optical frame in `base_link`."""
    return quat_normalize(quat_multiply(FLU_FROM_FRD, q_frd_from_camera))


def time(t_ns: int) -> RosMessage:
    """Vehicle time as ROS has it."""
    sec, nanosec = divmod(t_ns, NS_PER_S)
    return RosMessage("builtin_interfaces/msg/Time", {"sec": sec, "nanosec": nanosec})


def time_ns(stamp: Any) -> int:
    """Vehicle time of a stamp in ROS."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def attitude(orientation: Any) -> Quat:
    """Attitude in NED of a vehicle or a rover, from its orientation in a frame with x east and z up.

    Raises:
        ValueError: it is no rotation: a message that nobody has filled has a quaternion of zeros.
    """
    q: Quat = (float(orientation.w), float(orientation.x), float(orientation.y), float(orientation.z))
    if not 0.9 < sum(part * part for part in q) < 1.1:
        raise ValueError("its orientation is no unit quaternion")
    return q_ned_from_frd(quat_normalize(q))


def header(t_ns: int, frame_id: str) -> RosMessage:
    return RosMessage("std_msgs/msg/Header", {"stamp": time(t_ns), "frame_id": frame_id})


def vector(v: Vec3) -> RosMessage:
    return RosMessage("geometry_msgs/msg/Vector3", dict(zip("xyz", map(float, v), strict=True)))


def point(v: Vec3) -> RosMessage:
    return RosMessage("geometry_msgs/msg/Point", dict(zip("xyz", map(float, v), strict=True)))


def quaternion(q: Quat) -> RosMessage:
    return RosMessage("geometry_msgs/msg/Quaternion", dict(zip("wxyz", map(float, q), strict=True)))


def pose(position: Vec3, orientation: Quat) -> RosMessage:
    fields = {"position": point(position), "orientation": quaternion(orientation)}
    return RosMessage("geometry_msgs/msg/Pose", fields)


def twist(linear: Vec3, angular: Vec3) -> RosMessage:
    return RosMessage("geometry_msgs/msg/Twist", {"linear": vector(linear), "angular": vector(angular)})


def transform(t_ns: int, parent: str, child: str, translation: Vec3, rotation: Quat) -> RosMessage:
    """Pose of the child frame in its parent frame, as tf has it."""
    moved = RosMessage(
        "geometry_msgs/msg/Transform", {"translation": vector(translation), "rotation": quaternion(rotation)}
    )
    fields = {"header": header(t_ns, parent), "child_frame_id": child, "transform": moved}
    return RosMessage("geometry_msgs/msg/TransformStamped", fields)


def transforms(*all_of: RosMessage) -> RosMessage:
    return RosMessage("tf2_msgs/msg/TFMessage", {"transforms": list(all_of)})


def covariance(variances: Sequence[float], block: Sequence[Sequence[float]] | None = None) -> list[float]:
    """(36,) covariance of a pose or a twist, row by row.

    Args:
        variances: (6,) of x, y, z and the rotations about them.
        block: (3, 3) covariance of x, y, z, in place of the first three variances.
    """
    rows = [[0.0] * 6 for _ in range(6)]
    for i, variance in enumerate(variances):
        rows[i][i] = float(variance)
    for i, row in enumerate(block or ()):
        rows[i][0:3] = map(float, row)
    return [value for row in rows for value in row]


def turned_covariance(upper: Sequence[float], axes: Sequence[Vec3]) -> list[list[float]]:
    """(3, 3) covariance of the components along other axes.

    Args:
        upper: upper triangle of a symmetric 3x3 matrix, row by row.
        axes: (3, 3) the new axes as unit vectors in the old ones.
    """
    xx, xy, xz, yy, yz, zz = upper
    full = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    return [[sum(a[i] * full[i][j] * b[j] for i in range(3) for j in range(3)) for b in axes] for a in axes]
