"""Every rotation and axis convention of the project, in one table.

| name         | axes                     | where it is used                                      |
|--------------|--------------------------|-------------------------------------------------------|
| `ned`        | north, east, down        | the world frame: all messages and goals               |
| `enu`        | east, north, up          | the physics engine's world                            |
| `frd`        | forward, right, down     | the vehicle's body on MAVLink and in all messages     |
| `flu`        | forward, left, up        | the vehicle's body in the physics engine              |
| `rover`      | north, east, down        | origin at the centre of the landing platform          |
| `rover_body` | the same, turned by yaw  | what UWB measures in                                  |
| `camera`     | right, down, forward     | of the picture; forward is the optical axis           |

Vectors are tuples of three floats and quaternions are `(w, x, y, z)` with w >= 0: below ten elements plain
floats are several times faster than arrays. A quaternion `q_ned_from_frd` turns body vectors into NED.
"""

from math import asin, atan2, copysign, cos, degrees, hypot, pi, radians, sin, sqrt

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Matrix3 = tuple[float, float, float, float, float, float, float, float, float]

EARTH_RADIUS_M = 6_371_000.0
"""Radius of the local tangent projection; PX4 and jezero use the same sphere."""
_SQRT_HALF = sqrt(0.5)


GIMBAL_ACROSS_MIN = 0.05
"""Sine of the angle between the optical axis and the body's forward axis. With a smaller one the optical axis does not
show the roll."""


def ned_from_enu(v_enu: Vec3) -> Vec3:
    """Swap north and east and flip the vertical; its own inverse. Source: thesis eq. 2.1."""
    return (v_enu[1], v_enu[0], -v_enu[2])


enu_from_ned = ned_from_enu


def altitude_m(z_ned_m: float) -> float:
    """Height above the origin of a NED z coordinate, positive up."""
    return -z_ned_m


def z_ned_m(altitude_m: float) -> float:
    """NED z coordinate of a height above the origin."""
    return -altitude_m


def add(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vec3, factor: float) -> Vec3:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(a: Vec3) -> float:
    return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def distance(a: Vec3, b: Vec3) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return sqrt(x * x + y * y + z * z)


def horizontal(a: Vec3) -> float:
    """Length of the horizontal part."""
    return hypot(a[0], a[1])


def wrap_pi(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle_rad + pi) % (2.0 * pi) - pi


def quat_multiply(a: Quat, b: Quat) -> Quat:
    """Hamilton product: `q_a_from_c = quat_multiply(q_a_from_b, q_b_from_c)`."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def quat_conjugate(q: Quat) -> Quat:
    """The inverse rotation of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def quat_normalize(q: Quat) -> Quat:
    """Unit length and w >= 0.

    Raises:
        ValueError: the quaternion is zero or not finite.
    """
    n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if not 1e-12 < n < 1e12:
        raise ValueError(f"not a rotation: quaternion {q}")
    s = copysign(1.0 / n, q[0])
    return (q[0] * s, q[1] * s, q[2] * s, q[3] * s)


def quat_rotate(q_a_from_b: Quat, v_b: Vec3) -> Vec3:
    """Turn a vector of frame b into frame a."""
    w, x, y, z = q_a_from_b
    vx, vy, vz = v_b
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def rotation_matrix(q_a_from_b: Quat) -> Matrix3:
    """(9,) rotation matrix of a unit quaternion, row by row: `v_a = R_a_from_b @ v_b`."""
    w, x, y, z = q_a_from_b
    xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    return (
        1.0 - 2.0 * (yy + zz),
        2.0 * (xy - wz),
        2.0 * (xz + wy),
        2.0 * (xy + wz),
        1.0 - 2.0 * (xx + zz),
        2.0 * (yz - wx),
        2.0 * (xz - wy),
        2.0 * (yz + wx),
        1.0 - 2.0 * (xx + yy),
    )


def quat_from_rotation_vector(rotation_rad: Vec3) -> Quat:
    """Quaternion of a rotation by |v| about v."""
    angle = norm(rotation_rad)
    if angle < 1e-9:
        return quat_normalize((1.0, 0.5 * rotation_rad[0], 0.5 * rotation_rad[1], 0.5 * rotation_rad[2]))
    s = sin(0.5 * angle) / angle
    return quat_normalize((cos(0.5 * angle), rotation_rad[0] * s, rotation_rad[1] * s, rotation_rad[2] * s))


def quat_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quat:
    """Body-to-NED quaternion of yaw, then pitch, then roll (aerospace order)."""
    cr, sr = cos(0.5 * roll_rad), sin(0.5 * roll_rad)
    cp, sp = cos(0.5 * pitch_rad), sin(0.5 * pitch_rad)
    cy, sy = cos(0.5 * yaw_rad), sin(0.5 * yaw_rad)
    return quat_normalize(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


def euler_from_quat(q_ned_from_frd: Quat) -> Vec3:
    """(roll_rad, pitch_rad, yaw_rad) of a body-to-NED quaternion."""
    w, x, y, z = q_ned_from_frd
    sin_pitch = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(sin_pitch),
        yaw_from_quat(q_ned_from_frd),
    )


def yaw_from_quat(q_ned_from_frd: Quat) -> float:
    """Heading in radians, zero at north and positive towards east."""
    w, x, y, z = q_ned_from_frd
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def tilt_from_quat(q_ned_from_frd: Quat) -> float:
    """Angle between the body's down axis and the world's, in radians."""
    _, x, y, _ = q_ned_from_frd
    return 2.0 * asin(min(1.0, hypot(x, y)))


def q_ned_from_frd(q_enu_from_flu: Quat) -> Quat:
    """Attitude in MAVLink's axes from that in the physics engine's.

    Source: R_ned_from_enu @ R_enu_from_flu @ R_flu_from_frd, thesis eq. 2.1; as quaternions
    (0, 1, 1, 0) / sqrt(2) * q * (0, 1, 0, 0).
    """
    w, x, y, z = q_enu_from_flu
    h = _SQRT_HALF
    return quat_normalize((-h * w - h * z, -h * x - h * y, h * y - h * x, h * z - h * w))


def q_enu_from_flu(attitude: Quat) -> Quat:
    """Attitude in the physics engine's axes from that in MAVLink's: both changes of axes are half turns, so
    `q_ned_from_frd` is its own inverse."""
    return q_ned_from_frd(attitude)


def rotate_yaw(v: Vec3, yaw_rad: float) -> Vec3:
    """Turn a vector of a yawed frame into NED; with -yaw the other way. Source: thesis eq. 4.11."""
    c, s = cos(yaw_rad), sin(yaw_rad)
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def geodetic_from_ned(pos_ned_m: Vec3, origin_deg: Vec3) -> Vec3:
    """(latitude_deg, longitude_deg, altitude_m) of a local position.

    The projection is the azimuthal equidistant one of a sphere, with which PX4 makes its local position.

    Args:
        origin_deg: latitude and longitude in degrees and altitude in metres of the NED origin.
    Source: PX4's `MapProjection`.
    """
    lat0, lon0, alt0 = radians(origin_deg[0]), radians(origin_deg[1]), origin_deg[2]
    north, east = pos_ned_m[0] / EARTH_RADIUS_M, pos_ned_m[1] / EARTH_RADIUS_M
    angle = hypot(north, east)
    sinc = sin(angle) / angle if angle > 0.0 else 1.0
    lat = asin(max(-1.0, min(cos(angle) * sin(lat0) + north * sinc * cos(lat0), 1.0)))
    lon = lon0 + atan2(east * sinc, cos(lat0) * cos(angle) - north * sinc * sin(lat0))
    return (degrees(lat), degrees(wrap_pi(lon)), alt0 - pos_ned_m[2])


def origin_from(pos_ned_m: Vec3, position_deg: Vec3) -> Vec3:
    """The origin, as `geodetic_from_ned` takes it, of a frame in which both positions are the same place."""
    lat0 = position_deg[0] - pos_ned_m[0] / EARTH_RADIUS_M * 180.0 / pi
    lon0 = position_deg[1] - pos_ned_m[1] / (EARTH_RADIUS_M * cos(lat0 * pi / 180.0)) * 180.0 / pi
    return (lat0, lon0, position_deg[2] + pos_ned_m[2])


def ned_from_geodetic(position_deg: Vec3, origin_deg: Vec3) -> Vec3:
    """Inverse of `geodetic_from_ned`; metres."""
    lat0, lat, turn = radians(origin_deg[0]), radians(position_deg[0]), radians(position_deg[1] - origin_deg[1])
    north = cos(lat0) * sin(lat) - sin(lat0) * cos(lat) * cos(turn)
    east = cos(lat) * sin(turn)
    sine = hypot(north, east)
    angle = atan2(sine, sin(lat0) * sin(lat) + cos(lat0) * cos(lat) * cos(turn))
    scale_m = EARTH_RADIUS_M * (angle / sine if sine > 0.0 else 1.0)
    return (north * scale_m, east * scale_m, origin_deg[2] - position_deg[2])


def frd_from_camera(
    v_camera: Vec3, pitch_camera_rad: float, roll_camera_rad: float = 0.0, turn_camera_rad: float = 0.0
) -> Vec3:
    """Turn a vector of the camera into the body; at a pitch of -pi/2 it looks down, with the nose at the top.

    Args:
        roll_camera_rad: about the body's forward axis, which carries the pitch axis; positive looks to the left.
        turn_camera_rad: how far the camera is turned about its optical axis, clockwise in the direction of view.
    """
    right, down, forward = v_camera
    if turn_camera_rad:
        c, s = cos(turn_camera_rad), sin(turn_camera_rad)
        right, down = c * right - s * down, s * right + c * down
    c, s = cos(pitch_camera_rad), sin(pitch_camera_rad)
    x, z = s * down + c * forward, c * down - s * forward
    c, s = cos(roll_camera_rad), sin(roll_camera_rad)
    return (x, c * right - s * z, s * right + c * z)


def q_frd_from_camera(pitch_camera_rad: float, roll_camera_rad: float = 0.0, turn_camera_rad: float = 0.0) -> Quat:
    """The rotation of `frd_from_camera` as a quaternion."""
    axes = quat_from_euler(roll_camera_rad, 0.0, 0.0)
    axes = quat_multiply(axes, quat_from_euler(0.0, pitch_camera_rad, 0.0))
    axes = quat_multiply(axes, (0.5, 0.5, 0.5, 0.5))
    return quat_normalize(quat_multiply(axes, (cos(0.5 * turn_camera_rad), 0.0, 0.0, sin(0.5 * turn_camera_rad))))


def q_frd_from_gimbal(pitch_camera_rad: float, roll_camera_rad: float) -> Quat:
    """Attitude in the body of a gimbal (forward along the optical axis, right, down) by the angles of the camera."""
    return quat_multiply(quat_from_euler(roll_camera_rad, 0.0, 0.0), quat_from_euler(0.0, pitch_camera_rad, 0.0))


def gimbal_angles(q_frd_from_gimbal: Quat) -> tuple[float, float]:
    """Pitch and roll of the camera by the attitude of its gimbal in the body; inverse of `q_frd_from_gimbal`.

    A turn about the optical axis is left out: the angles have none.
    """
    forward, right, down = quat_rotate(q_frd_from_gimbal, (1.0, 0.0, 0.0))
    across, below = hypot(right, down), copysign(1.0, down)
    pitch_rad = -below * atan2(across, forward)
    if across > GIMBAL_ACROSS_MIN:
        return pitch_rad, atan2(-below * right, below * down)
    _, y, z = quat_rotate(q_frd_from_gimbal, (0.0, 1.0, 0.0))  # the axis across shows the roll
    return pitch_rad, atan2(z, y)


def q_level_from_frd(q_ned_from_frd: Quat) -> Quat:
    """Roll and pitch of a vehicle: its attitude in the level frame that has its heading."""
    return quat_multiply(quat_from_euler(0.0, 0.0, -yaw_from_quat(q_ned_from_frd)), q_ned_from_frd)


def quat_between(a: Quat, b: Quat, fraction: float) -> Quat:
    """Interpolate between two attitudes that are near each other (normalised linear); a fraction of 0 is `a`."""
    sign = copysign(1.0, a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    w, x, y, z = (p + fraction * (sign * q - p) for p, q in zip(a, b, strict=True))
    return quat_normalize((w, x, y, z))
