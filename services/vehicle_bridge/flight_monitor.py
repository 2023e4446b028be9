"""Detection of the conditions that end a flight: tilt, and the loss of telemetry or of the bus's router."""

from math import degrees

from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot


class FlightMonitor:
    """Compares the vehicle with the limits and time-outs of a flight; each method returns a reason, or None."""

    def __init__(self, config: VehicleBridgeConfig) -> None:
        self._config = config
        self._upright_ns = 0

    def update(self, vehicle: VehicleSnapshot, *, flying: bool) -> None:
        """Measure the time since the vehicle was last upright, while the bridge flies it."""
        if not (flying and vehicle.armed and vehicle.tilt_rad > self._config.tilt_limit_rad):
            self._upright_ns = vehicle.timer_ns

    def tilt_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to cut the motors."""
        timeout_s = self._config.tilt_timeout_s
        if (vehicle.timer_ns - self._upright_ns) * 1e-9 < timeout_s:
            return None
        return f"motors cut: tilted by {degrees(vehicle.tilt_rad):.0f} degrees for {timeout_s:g} s"

    def link_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to end a goal."""
        age_s = vehicle.telemetry_age_s
        return f"no telemetry for {age_s:.1f} s" if age_s > self._config.link_timeout_s else None

    def blind_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to stop streaming."""
        age_s = vehicle.telemetry_age_s
        if age_s <= self._config.blind_timeout_s:
            return None
        return f"no telemetry for {age_s:.1f} s: left to the autopilot's failsafe"

    def router_reason(self, vehicle: VehicleSnapshot) -> str | None:
        """Reason to land."""
        lost_s = vehicle.router_lost_s
        if lost_s < self._config.router_timeout_s or not vehicle.armed or vehicle.landed:
            return None
        return f"landing: the bus's router has been missing for {lost_s:.0f} s"
