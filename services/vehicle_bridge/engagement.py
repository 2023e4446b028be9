"""Timing of the way into offboard mode, at the start of a goal and when control is taken back."""

from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot

STREAM_LEAD_S = 0.2
"""Setpoints are streamed for this time before the autopilot is commanded into offboard mode."""
ENGAGE_TIMEOUT_S = 5.0
"""Time-out of offboard mode and arming together."""


class EngagementTimer:
    """Measures the time since the bridge began to stream in order to get into offboard mode."""

    def __init__(self) -> None:
        self._start_ns = 0

    def start(self, vehicle: VehicleSnapshot) -> None:
        """Begin now."""
        self._start_ns = vehicle.timer_ns

    def may_command(self, vehicle: VehicleSnapshot) -> bool:
        """Whether the stream has run for long enough for offboard mode."""
        return self._elapsed_s(vehicle) >= STREAM_LEAD_S

    def is_overdue(self, vehicle: VehicleSnapshot) -> bool:
        """Whether the time-out has passed."""
        return self._elapsed_s(vehicle) > ENGAGE_TIMEOUT_S

    def _elapsed_s(self, vehicle: VehicleSnapshot) -> float:
        return (vehicle.timer_ns - self._start_ns) * 1e-9
