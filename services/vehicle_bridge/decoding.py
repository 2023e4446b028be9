"""Contents of the autopilot's MAVLink messages."""

from math import nan, sqrt

from jezero.frames import Quat, Vec3, quat_normalize, quat_rotate
from jezero.mavlink import FieldReader, MavMessage, dialect
from jezero.services.vehicle_bridge.foreign_setpoints import SetpointEcho

_LOCAL_NED = dialect.MAV_FRAME_LOCAL_NED
_ODOMETRY = FieldReader(
    dialect.MAVLink_odometry_message,
    *("time_usec", "x", "y", "z", "q", "vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed"),
    *("pose_covariance[0]", "pose_covariance[6]", "frame_id", "child_frame_id", "reset_counter"),
)


def text_of(field: str | bytes) -> str:
    """A MAVLink string without its padding."""
    return (field if isinstance(field, str) else field.decode("utf-8", "replace")).rstrip("\0")


def setpoint_echo_of(message: MavMessage) -> SetpointEcho:
    """Echo in a POSITION_TARGET_LOCAL_NED, with NaN in each masked axis."""
    fields = ("x", "y", "z", "vx", "vy", "vz")
    x, y, z, vx, vy, vz = (nan if message.type_mask >> i & 1 else getattr(message, f) for i, f in enumerate(fields))
    return SetpointEcho(message.time_boot_ms * 1_000_000, (x, y, z), (vx, vy, vz))


def odometry_of(message: MavMessage) -> tuple[int, Vec3, Vec3, Quat, Vec3, float | None, int]:
    """Contents of an ODOMETRY.

    Returns:
        Time in ns, position, velocity and attitude in world NED, body rates in FRD, horizontal standard deviation of
        the position in m, reset counter.
    Raises:
        ValueError: a number is not finite or out of its range, or a frame is unknown.
    """
    numbers = _ODOMETRY(message)
    t_us, x, y, z, qw, qx, qy, qz, vx, vy, vz, p, q, r, var_north_m2, var_east_m2, frame, child_frame, counter = numbers
    pos, vel, rates = (x, y, z), (vx, vy, vz), (p, q, r)
    if frame != _LOCAL_NED:
        raise ValueError("not a pose in local NED")
    attitude = quat_normalize((qw, qx, qy, qz))
    if child_frame == dialect.MAV_FRAME_BODY_FRD:
        vel = quat_rotate(attitude, vel)
    elif child_frame != _LOCAL_NED:
        raise ValueError("velocity in an unknown frame")
    t_ns = t_us * 1000
    if t_ns > 2**62:
        raise ValueError("time out of range")
    vx, vy, vz = vel
    small = x * x + y * y + z * z <= 1e10 and vx * vx + vy * vy + vz * vz <= 1e6 and p * p + q * q + r * r <= 1e6
    if not small:  # or NaN
        raise ValueError("not finite, or out of range")
    variance_m2 = max(var_north_m2, var_east_m2)
    std_m = sqrt(variance_m2) if 0.0 <= variance_m2 <= 1e12 else None
    return t_ns, pos, vel, attitude, rates, std_m, counter
