"""Hover of a paused landing: clear of the ground and of the platform, and along with the rover while it is in sight."""

from math import hypot

from jezero.base.frames import Vec3, add, subtract
from jezero.services.actions.motion.tracking import ZERO, clipped

SPEED_MAX_MPS, ACCELERATION_MPS2 = 1.0, 1.0
"""Limits of the motion to the hover point, relative to its frame."""


class PausedHover:
    """Hover point of one pause, in the rover's frame or in the world.

    Args:
        height_min_m: a lower vehicle climbs to this height, because hovering close to something is not safe.
        vel_ned_mps: velocity setpoint over ground at the begin.
    """

    def __init__(self, height_min_m: float, vel_ned_mps: Vec3 = ZERO) -> None:
        self._height_min_m = height_min_m
        self._point_ned_m: Vec3 | None = None
        self._in_rover_frame = False
        self._frame_ned_mps = vel_ned_mps
        self._vel_ned_mps = ZERO
        """Velocity setpoint relative to the frame."""

    def velocity(
        self,
        dt_s: float,
        pos_ned_m: Vec3,
        height_m: float | None,
        vel_rover_ned_mps: Vec3 | None = None,
    ) -> Vec3:
        """Velocity setpoint over ground towards the hover point; it changes no faster than the acceleration allows.

        Args:
            dt_s: since the last call.
            pos_ned_m: position of the vehicle in the rover's frame, or in the world.
            height_m: of the vehicle over platform or ground; None while it is unknown, and then it doesn't climb.
            vel_rover_ned_mps: velocity of the rover, for a hover in its frame; None for one in the world.
        """
        frame_ned_mps = vel_rover_ned_mps or ZERO
        in_rover_frame = vel_rover_ned_mps is not None
        if self._point_ned_m is None or in_rover_frame is not self._in_rover_frame:
            climb_m = 0.0 if height_m is None else max(self._height_min_m - height_m, 0.0)
            self._point_ned_m = add(pos_ned_m, (0.0, 0.0, -climb_m))
            self._vel_ned_mps = add(self._vel_ned_mps, subtract(self._frame_ned_mps, frame_ned_mps))
            self._in_rover_frame = in_rover_frame
        self._frame_ned_mps = frame_ned_mps
        wanted_ned_mps = towards(subtract(self._point_ned_m, pos_ned_m), SPEED_MAX_MPS)
        change = clipped(subtract(wanted_ned_mps, self._vel_ned_mps), ACCELERATION_MPS2 * dt_s)
        self._vel_ned_mps = add(self._vel_ned_mps, change)
        return add(self._vel_ned_mps, frame_ned_mps)


def towards(offset_m: tuple[float, float, float], speed_mps: float, gain_1ps: float = 0.8) -> Vec3:
    """Velocity along an offset, proportional to its length and limited."""
    length_m = hypot(*offset_m)
    pull_1ps = min(gain_1ps, speed_mps / max(length_m, 1e-9))
    return (pull_1ps * offset_m[0], pull_1ps * offset_m[1], pull_1ps * offset_m[2])
