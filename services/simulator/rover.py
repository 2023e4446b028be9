"""Motion of the rover: a platform that follows the ground at a given speed and yaw rate."""

from math import cos, sin

from jezero.frames import wrap_pi
from jezero.services.simulator.body import RoverState
from jezero.services.simulator.config import RoverConfig
from jezero.services.simulator.terrain import Terrain


class Rover:
    """Turns speed and yaw rate into the platform's pose; stands still unless driven.

    Args:
        height_platform_m: height of the platform's surface over the ground.
    """

    def __init__(self, config: RoverConfig, terrain: Terrain, height_platform_m: float) -> None:
        self._terrain = terrain
        self._height_platform_m = height_platform_m
        north_m, east_m = config.start_north_m, config.start_east_m
        down_m = -self._top_height_m(north_m, east_m)
        self.state = RoverState((north_m, east_m, down_m), (0.0, 0.0, 0.0), config.start_yaw_rad, 0.0, 0.0)

    def drive(self, speed_mps: float, yaw_rate_rps: float, dt_s: float) -> RoverState:
        """Advance by one step along an arc; velocities in the result are means over this step."""
        (north_m, east_m, down_m), yaw_rad = self.state.pos_ned_m, self.state.yaw_rad
        middle_rad = yaw_rad + 0.5 * yaw_rate_rps * dt_s
        vel_north_mps, vel_east_mps = speed_mps * cos(middle_rad), speed_mps * sin(middle_rad)
        north_m += vel_north_mps * dt_s
        east_m += vel_east_mps * dt_s
        new_down_m = -self._top_height_m(north_m, east_m)
        self.state = RoverState(
            (north_m, east_m, new_down_m),
            (vel_north_mps, vel_east_mps, (new_down_m - down_m) / dt_s),
            wrap_pi(yaw_rad + yaw_rate_rps * dt_s),
            speed_mps,
            yaw_rate_rps,
        )
        return self.state

    def _top_height_m(self, north_m: float, east_m: float) -> float:
        return self._terrain.height_m(north_m, east_m) + self._height_platform_m
