"""Where the bridge itself sends the vehicle: to rest, up from the ground, or firmly onto it."""

from jezero.frames import Vec3
from jezero.services.vehicle_bridge.vehicle import Situation, Target

STOP_WITHIN_S = 0.5
"""A hover begins where the present velocity leads in this time, so that the vehicle needn't turn back."""
PRESS_DOWN_MPS = 0.5
"""Commanded descent on the ground until the motors stop. Source: spec §8."""


def coming_to_rest(pos_ned_m: Vec3, now: Situation, yaw_rad: float, low_height_m: float) -> Target:
    """Hover where the vehicle stops by itself; a descent ends above the low height.

    Args:
        pos_ned_m: (3,) where it is.
    """
    vel = now.vel_ned_mps
    room_m = max(0.0, (now.height_m or 0.0) - low_height_m)
    down_m = min(vel[2] * STOP_WITHIN_S, room_m)
    point = (pos_ned_m[0] + vel[0] * STOP_WITHIN_S, pos_ned_m[1] + vel[1] * STOP_WITHIN_S, pos_ned_m[2] + down_m)
    return Target(point, None, None, yaw_rad)


def climbing(rest: Target, z_ned_m: float, up_m: float) -> Target:
    """Hover over the point of rest, `up_m` above the height at which the vehicle is, `z_ned_m`."""
    north_m, east_m, _ = rest.pos_ned_m or (0.0, 0.0, 0.0)
    return Target((north_m, east_m, z_ned_m - up_m), None, None, rest.yaw_rad)


def pressing_down(before: Target | None, yaw_rad: float) -> Target:
    """What keeps the vehicle on the ground, or on the deck it follows, until its motors stop."""
    vel = None if before is None else before.vel_ned_mps
    north_mps, east_mps, _ = vel or (0.0, 0.0, 0.0)
    return Target(None, (north_mps, east_mps, PRESS_DOWN_MPS), None, yaw_rad)
