"""Detection of the conditions that end a flight: tilt, and the loss of telemetry or of the bus's router."""

from math import degrees

from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S, VehicleSnapshot

TILT_LIMIT_RAD, TILT_TIMEOUT_S = 1.0472, 0.5
"""A vehicle that is tilted further than 60 degrees for this time is upside down or lies against something: no
controller tilts it as far."""
BLIND_TIMEOUT_S = 5.0
"""Without telemetry for this time, the bridge stops streaming, and the autopilot lands by itself."""


class FlightMonitor:
    """Compares the vehicle with the limits and time-outs of a flight; each method returns a reason, or None."""

    def __init__(self, config: VehicleBridgeConfig) -> None:
        self._config = config
        self._upright_ns = 0

    def update(self, vehicle: VehicleSnapshot, *, flying: bool) -> None:
        """Measure the time since the vehicle was last upright, while the bridge flies it."""
        if not (flying and vehicle.armed and vehicle.tilt_rad > TILT_LIMIT_RAD):
            self._upright_ns = vehicle.timer_ns

    def tilt_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to cut the motors."""
        if (vehicle.timer_ns - self._upright_ns) * 1e-9 < TILT_TIMEOUT_S:
            return None
        return f"motors cut: tilted by {degrees(vehicle.tilt_rad):.0f} degrees for {TILT_TIMEOUT_S:g} s"

    def link_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to end a goal."""
        age_s = vehicle.telemetry_age_s
        return f"no telemetry for {age_s:.1f} s" if age_s > LINK_TIMEOUT_S else None

    def blind_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to stop streaming."""
        age_s = vehicle.telemetry_age_s
        if age_s <= BLIND_TIMEOUT_S:
            return None
        return f"no telemetry for {age_s:.1f} s: left to the autopilot's failsafe"

    def router_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to land."""
        lost_s = vehicle.router_lost_s
        if lost_s < self._config.router_timeout_s or not vehicle.armed or vehicle.landed:
            return None
        return f"landing: the bus's router has been missing for {lost_s:.0f} s"
