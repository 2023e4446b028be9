"""Where the bridge itself sends the vehicle: to rest, up from the ground, or firmly onto it."""

from jezero.schemas.commands import Release
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.resets import ResetHistory
from jezero.services.vehicle_bridge.vehicle import Situation, Target

STOP_WITHIN_S = 0.5
"""A hover begins where the present velocity leads in this time, so that the vehicle needn't turn back."""
CLIMB_TIMEOUT_S = 5.0
CLIMB_TOLERANCE_M = 0.3
PRESS_DOWN_MPS = 0.5
"""Commanded descent on the ground until the motors stop. Source: spec §8."""


def coming_to_rest(now: Situation, yaw_rad: float, low_height_m: float) -> Target:
    """Hover where the vehicle stops by itself; a descent ends above the low height."""
    pos_ned_m, vel = now.pos_ned_m or (0.0, 0.0, 0.0), now.vel_ned_mps
    room_m = max(0.0, (now.height_m or 0.0) - low_height_m)
    down_m = min(vel[2] * STOP_WITHIN_S, room_m)
    point = (pos_ned_m[0] + vel[0] * STOP_WITHIN_S, pos_ned_m[1] + vel[1] * STOP_WITHIN_S, pos_ned_m[2] + down_m)
    return Target(point, None, None, yaw_rad)


def hovering_after(release: Release, rest: Target, resets: ResetHistory) -> Target:
    """Hover where the goal that has ended says, with the heading of `rest`; there, where it says nothing that holds."""
    step_ned_m = resets.step_since(release.reset_counter)
    if release.hover_pos_ned_m is None or step_ned_m is None:
        return rest
    return Target(release.hover_pos_ned_m, None, None, rest.yaw_rad).moved(step_ned_m)


def pressing_down(before: Target | None, yaw_rad: float) -> Target:
    """What keeps the vehicle on the ground, or on the deck it follows, until its motors stop."""
    vel = None if before is None else before.vel_ned_mps
    north_mps, east_mps, _ = vel or (0.0, 0.0, 0.0)
    return Target(None, (north_mps, east_mps, PRESS_DOWN_MPS), None, yaw_rad)


class Aborting:
    """An aborted vehicle stays on the ground, climbs when it is near it, and comes to rest elsewhere.

    Attributes:
        on_ground: where it was when it was planned.
    """

    def __init__(self, config: VehicleBridgeConfig) -> None:
        self.on_ground = False
        self._climbs = False
        self._config = config

    def plan(self, before: Target | None, now: Situation, yaw_rad: float) -> Target | None:
        """What to stream; in the air position and height must be known."""
        config = self._config
        self.on_ground, self._climbs = now.landed, False
        if now.landed:
            return pressing_down(before, yaw_rad) if now.armed else None
        rest = coming_to_rest(now, yaw_rad, config.low_height_m)
        here_ned_m, height_m = now.pos_ned_m, now.height_m
        if rest.pos_ned_m is None or here_ned_m is None or height_m is None or height_m >= config.low_height_m:
            return rest
        self._climbs = True
        north_m, east_m, _ = rest.pos_ned_m
        return Target((north_m, east_m, here_ned_m[2] - (config.climb_height_m - height_m)), None, None, yaw_rad)

    def is_done(self, now: Situation, held_s: float) -> bool:
        """Whether the vehicle is as high as it should be, or has tried for long enough."""
        high = now.height_m is None or now.height_m >= self._config.climb_height_m - CLIMB_TOLERANCE_M
        return high or not self._climbs or held_s >= CLIMB_TIMEOUT_S
