"""A gimbal that the flight controller manages, by MAVLink's gimbal protocol v2: it is claimed, pointed and measured.

MAVLink's angles of roll and pitch are against the horizon, and its yaw here against the vehicle's heading; jezero's are
those of two axes on the body. Both are converted by the vehicle's attitude.
"""

from collections.abc import Iterator, Sequence
from math import pi

from jezero.base.frames import (
    Quat,
    euler_from_quat,
    gimbal_angles,
    q_frd_from_gimbal,
    q_level_from_frd,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_normalize,
    yaw_from_quat,
)
from jezero.base.mavlink import MavMessage, dialect
from jezero.schemas.commands import CameraPitch
from jezero.schemas.sensors import CameraAttitude
from jezero.schemas.units import NS_PER_S

PERIOD_NS = 45_000_000
"""A little less than the period of `command/camera_pitch`."""
CLAIM_PERIOD_NS = NS_PER_S
HOLD_NS = NS_PER_S
"""A command holds for this time; then the camera returns to its angles at rest."""
SILENT_NS = 2 * NS_PER_S
INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: 50_000,
    dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: 1_000_000,
}
LOCKS = dialect.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | dialect.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
FLAGS = LOCKS | dialect.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
EARTH_YAW = dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
YAW_LOCK = dialect.GIMBAL_DEVICE_FLAGS_YAW_LOCK
VEHICLE_YAW = dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
ALL_DEVICES = 0
STEEP_RAD = -1.4
"""A camera that is to look down more steeply is sent straight down: there roll and yaw are one, and PX4, which limits
each of them, would turn the gimbal to and fro. The measured angles hold in any case."""
STRAIGHT_DOWN = quat_from_euler(0.0, -0.5 * pi, 0.0)
UNKNOWN = float("nan")


class GimbalClient:
    """Claims the gimbal, points it, and reads its attitude.

    Args:
        own: MAVLink system and component id of the bridge.
        manager: those of the gimbal manager.
        rest_rad: pitch and roll at rest.
    """

    def __init__(self, own: tuple[int, int], manager: tuple[int, int], rest_rad: tuple[float, float]) -> None:
        self._own = own
        self._manager = manager
        self._rest_rad = rest_rad
        self._command: tuple[CameraPitch, int] | None = None
        """The newest command, and the wall time of its arrival."""
        self._sent_ns = self._claimed_ns = -CLAIM_PERIOD_NS
        self._since_ns: int | None = None
        self._heard_ns: int | None = None
        self._in_control: tuple[int, int] | None = None
        self._failure_flags = 0

    def point(self, commands: Sequence[CameraPitch], wall_ns: int) -> None:
        """Take in new commands."""
        if commands:
            self._command = (commands[-1], wall_ns)

    def due(self, q_ned_from_frd: Quat, wall_ns: int) -> Iterator[MavMessage]:
        """Messages that are due now.

        Args:
            q_ned_from_frd: the vehicle's attitude.
        """
        if self._since_ns is None:
            self._since_ns = wall_ns
        is_lost = self._heard_ns is None or wall_ns - self._heard_ns > SILENT_NS  # it may have been started anew
        if (is_lost or self._in_control != self._own) and wall_ns - self._claimed_ns >= CLAIM_PERIOD_NS:
            self._claimed_ns = wall_ns
            primary, unchanged = map(float, self._own), -1.0
            yield dialect.MAVLink_command_long_message(
                *self._manager, dialect.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, 0,
                *primary, unchanged, unchanged, 0.0, 0.0, float(ALL_DEVICES),
            )  # fmt: skip
        if wall_ns - self._sent_ns < PERIOD_NS:
            return
        self._sent_ns = wall_ns
        pitch_rad, roll_rad = self._rest_rad
        if self._command is not None and wall_ns - self._command[1] <= HOLD_NS:
            pitch_rad, roll_rad = self._command[0].pitch_camera_rad, self._command[0].roll_camera_rad
        q_level = quat_multiply(q_level_from_frd(q_ned_from_frd), q_frd_from_gimbal(pitch_rad, roll_rad))
        level_roll_rad, level_pitch_rad, _ = euler_from_quat(q_level)
        if level_pitch_rad < STEEP_RAD or abs(level_roll_rad) > 0.5 * pi:
            q_level = STRAIGHT_DOWN
        yield dialect.MAVLink_gimbal_manager_set_attitude_message(
            *self._manager, FLAGS, ALL_DEVICES, list(q_level), UNKNOWN, UNKNOWN, UNKNOWN
        )

    def on_status(self, message: MavMessage) -> None:
        """Take in GIMBAL_MANAGER_STATUS: who is in control."""
        self._in_control = (message.primary_control_sysid, message.primary_control_compid)

    def on_attitude(self, message: MavMessage, t_ns: int, q_ned_from_frd: Quat, wall_ns: int) -> CameraAttitude:
        """The camera's angles by GIMBAL_DEVICE_ATTITUDE_STATUS, whose own time is that of the gimbal's boot.

        Args:
            t_ns: time of the vehicle's attitude, the newest one.
            q_ned_from_frd: the vehicle's attitude.

        Raises:
            ValueError: the attitude is no rotation.
        """
        w, x, y, z = message.q
        q_gimbal = quat_normalize((w, x, y, z))
        self._heard_ns = wall_ns
        self._failure_flags = message.failure_flags
        flags = message.flags
        if flags & EARTH_YAW or flags & (VEHICLE_YAW | YAW_LOCK) == YAW_LOCK:
            q_gimbal = quat_multiply(quat_from_euler(0.0, 0.0, -yaw_from_quat(q_ned_from_frd)), q_gimbal)
        pitch_rad, roll_rad = gimbal_angles(quat_multiply(quat_conjugate(q_level_from_frd(q_ned_from_frd)), q_gimbal))
        return CameraAttitude(t_ns=t_ns, pitch_camera_rad=pitch_rad, roll_camera_rad=roll_rad)

    def problem(self, wall_ns: int) -> str:
        """What is wrong with the gimbal, for people; "" for nothing."""
        since_ns = self._since_ns if self._heard_ns is None else self._heard_ns
        if since_ns is not None and wall_ns - since_ns > SILENT_NS:
            return (
                f"no gimbal has answered for {(wall_ns - since_ns) / NS_PER_S:.0f} s: is it on, and does the flight "
                'controller manage it (PX4: MNT_MODE_IN 4)? Without one set gimbal = "fixed" in vehicle.toml'
            )
        if self._failure_flags:
            return f"the gimbal reports a failure (flags {self._failure_flags:#x})"
        if self._in_control not in (None, self._own):
            return "MAVLink system {}, component {} is in control of the gimbal".format(*self._in_control)
        return ""
