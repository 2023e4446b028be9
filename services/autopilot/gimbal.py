"""The gimbal manager, with a gimbal of two axes on the body: MAVLink's gimbal protocol v2, as PX4 has it.

It turns the simulated camera of the same stack, once somebody on MAVLink has taken control of it.
"""

from jezero.base.frames import (
    Quat,
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

RATE_MAX_RPS = 2.0
PITCH_MIN_RAD, ROLL_MAX_RAD = -1.5708, 0.8
"""Limits of the axes, as of `command/camera_pitch`; the pitch ends at 0."""
PERIOD_US = 50_000
"""Period in which the simulated camera gets the angles."""
LOCKS = dialect.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | dialect.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
NOBODY = (0, 0)
LEAVE, SENDER, RELEASE = (-1.0, -1.0), (-2.0, -2.0), (-3.0, -3.0)
"""Ids in MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE that leave control where it is, take the sender, or release it."""


class GimbalManager:
    """Follows the angles that its controller sends, at a bounded rate.

    Attributes:
        controller: MAVLink system and component id of who is in control; `NOBODY` at first.
        pitch_rad: of the camera's optical axis against the body's forward axis.
        roll_rad: of the pitch axis about the body's forward axis.
    """

    def __init__(self) -> None:
        self.controller = NOBODY
        self.pitch_rad, self.roll_rad = PITCH_MIN_RAD, 0.0
        self._target_rad = (PITCH_MIN_RAD, 0.0)
        self._moved_us: int | None = None
        self._due_us = 0

    def configure(self, primary: tuple[float, float], sender: tuple[int, int]) -> bool:
        """Change who is in control, by MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE; returns whether that is accepted.

        Args:
            primary: system and component id of the new controller, or `LEAVE`, `SENDER` or `RELEASE`.
            sender: of the command.
        """
        if primary == SENDER:
            self.controller = sender
        elif primary == RELEASE:
            self.controller = NOBODY if self.controller == sender else self.controller
        elif primary != LEAVE:
            if not all(each in range(256) for each in primary):
                return False
            self.controller = (int(primary[0]), int(primary[1]))
        return True

    def on_attitude(self, message: MavMessage, q_ned_from_frd: Quat) -> None:
        """Take in GIMBAL_MANAGER_SET_ATTITUDE of the controller; others have no control."""
        if (message.get_srcSystem(), message.get_srcComponent()) != self.controller:
            return
        try:
            w, x, y, z = message.q
            q = quat_normalize((w, x, y, z))
        except ValueError:
            return
        if message.flags & dialect.GIMBAL_MANAGER_FLAGS_YAW_LOCK:
            q = quat_multiply(quat_from_euler(0.0, 0.0, -yaw_from_quat(q_ned_from_frd)), q)
        if message.flags & LOCKS:
            q = quat_multiply(quat_conjugate(q_level_from_frd(q_ned_from_frd)), q)
        pitch_rad, roll_rad = gimbal_angles(q)
        roll_rad = min(ROLL_MAX_RAD, max(-ROLL_MAX_RAD, roll_rad))
        self._target_rad = (min(0.0, max(PITCH_MIN_RAD, pitch_rad)), roll_rad)

    def move(self, t_us: int) -> bool:
        """Turn the axes until a time; returns whether the camera is to get the angles."""
        reach_rad = 0.0 if self._moved_us is None else RATE_MAX_RPS * max(0, t_us - self._moved_us) * 1e-6
        self._moved_us = t_us
        pitch_rad, roll_rad = self._target_rad
        self.pitch_rad += min(reach_rad, max(-reach_rad, pitch_rad - self.pitch_rad))
        self.roll_rad += min(reach_rad, max(-reach_rad, roll_rad - self.roll_rad))
        if self.controller == NOBODY or t_us < self._due_us:
            return False
        self._due_us = t_us + PERIOD_US
        return True

    def q_level(self, q_ned_from_frd: Quat) -> Quat:
        """Attitude against the horizon and the vehicle's heading, as GIMBAL_DEVICE_ATTITUDE_STATUS has it."""
        return quat_multiply(q_level_from_frd(q_ned_from_frd), q_frd_from_gimbal(self.pitch_rad, self.roll_rad))
