"""The manoeuvre after an abort."""

from jezero.services.vehicle_bridge.targets import LOW_HEIGHT_M, press_down_target, stopping_target
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

CLIMB_HEIGHT_M = 1.5
"""Height over ground or platform to which a low vehicle climbs."""
CLIMB_TIMEOUT_S = 5.0
CLIMB_TOLERANCE_M = 0.3


class AbortManeuver:
    """An aborted vehicle stays on the ground, climbs when it is near the ground, and else comes to rest.

    Attributes:
        on_ground: the vehicle was on the ground when the manoeuvre was planned.
    """

    def __init__(self) -> None:
        self.on_ground = False
        self._climbs = False

    def plan(self, previous: Target | None, vehicle: VehicleSnapshot) -> Target | None:
        """Target of the manoeuvre, None for no stream; in the air position and height must be known."""
        self.on_ground, self._climbs = vehicle.landed, False
        if vehicle.landed:
            return press_down_target(previous, vehicle) if vehicle.armed else None
        stopping = stopping_target(previous, vehicle)
        pos_ned_m, height_m = vehicle.pos_ned_m, vehicle.height_m
        if stopping.pos_ned_m is None or pos_ned_m is None or height_m is None or height_m >= LOW_HEIGHT_M:
            return stopping
        self._climbs = True
        north_m, east_m, _ = stopping.pos_ned_m
        return Target((north_m, east_m, pos_ned_m[2] - (CLIMB_HEIGHT_M - height_m)), None, None, stopping.yaw_rad)

    def is_done(self, vehicle: VehicleSnapshot, elapsed_s: float) -> bool:
        """Whether the vehicle is high enough, or has tried to climb until the time-out."""
        high = vehicle.height_m is None or vehicle.height_m >= CLIMB_HEIGHT_M - CLIMB_TOLERANCE_M
        return high or not self._climbs or elapsed_s >= CLIMB_TIMEOUT_S
