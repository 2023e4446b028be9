"""Detection of an idle autopilot that stands in a mode in which it can't be armed."""

from jezero.services.vehicle_bridge.vehicle import UNARMABLE_MODES, VehicleSnapshot

OWN_FLIGHT_TIMEOUT_S = 5.0
"""Hold mode is commanded for at most this time after the bridge's own flight."""
UNARMABLE_MIN_S = 2.0
"""After somebody else's flight, the vehicle must have been unable to arm in that mode for this time."""
FOREIGN_FLIGHT_TIMEOUT_S = 10.0
"""Hold mode is not commanded later than this after somebody else's flight: a pilot may be about to arm."""


class UnarmableModeDetector:
    """Detects that an idle autopilot needs hold mode before it can be armed again.

    PX4 returns to offboard mode when it has been landed from it, and then can't be armed without a setpoint stream.
    """

    def __init__(self) -> None:
        self._own_flight = True
        self._since_ns = self._armable_ns = 0

    def reset(self, vehicle: VehicleSnapshot, *, own_flight: bool) -> None:
        """Start again when the vehicle becomes idle; `own_flight` when nobody else has flown it."""
        self._own_flight = own_flight
        self._since_ns = self._armable_ns = vehicle.timer_ns

    def update(self, vehicle: VehicleSnapshot) -> bool:
        """Whether to command hold mode now."""
        unarmable = vehicle.armed is False and vehicle.mode in UNARMABLE_MODES
        if not unarmable or vehicle.armable:
            self._armable_ns = vehicle.timer_ns
        idle_s = (vehicle.timer_ns - self._since_ns) * 1e-9
        self._own_flight &= idle_s <= OWN_FLIGHT_TIMEOUT_S and (unarmable or not vehicle.mode)
        unarmable_s = (vehicle.timer_ns - self._armable_ns) * 1e-9
        abandoned = unarmable_s >= UNARMABLE_MIN_S and idle_s <= FOREIGN_FLIGHT_TIMEOUT_S
        return unarmable and (self._own_flight or abandoned)
