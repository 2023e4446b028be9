"""Detection of control by others: another MAVLink system, or the autopilot's failsafe. Source: architecture §5."""

from jezero.schemas.state import InCharge
from jezero.services.vehicle_bridge.vehicle import OFFBOARD, VehicleSnapshot

Takeover = tuple[InCharge, str]
"""The new holder of control, and the reason for people."""

OFFBOARD_LEFT_MIN_S = 0.3
"""A vehicle that was about to arm and has been out of offboard mode for this time was given another mode."""


class TakeoverDetector:
    """Detects that somebody else controls the vehicle, from changes that the bridge did not command."""

    def __init__(self) -> None:
        self._offboard_ns: int | None = None
        """When the autopilot, commanded to arm, was last in offboard mode."""
        self._external_mode: tuple[str, bool] = ("", False)
        """Mode while others fly, and whether a failsafe chose it."""

    def reset(self, vehicle: VehicleSnapshot) -> None:
        """Start again when the status code changes."""
        self._offboard_ns = None
        self._external_mode = (vehicle.mode, vehicle.failsafe)

    @property
    def was_offboard(self) -> bool:
        """Whether the vehicle was about to arm in offboard mode. If it has left it, the bridge must not command
        offboard mode again: that would override the pilot who changed it."""
        return self._offboard_ns is not None

    def before_lift_off(self, vehicle: VehicleSnapshot, *, arm_commanded: bool) -> Takeover | None:
        """Takeover while the bridge commands offboard mode and arming, None without one."""
        if vehicle.armed and not (arm_commanded and vehicle.mode == OFFBOARD):
            return _takeover("armed, and not by the bridge", vehicle)
        if vehicle.mode == OFFBOARD:
            self._offboard_ns = vehicle.timer_ns if arm_commanded else None
        elif self._offboard_ns is not None and (vehicle.timer_ns - self._offboard_ns) * 1e-9 >= OFFBOARD_LEFT_MIN_S:
            return _takeover(f"the autopilot was switched to {vehicle.mode}", vehicle)
        return None

    def in_flight(self, vehicle: VehicleSnapshot) -> Takeover | None:
        """Takeover while the bridge flies in offboard mode, None without one."""
        if vehicle.armed and vehicle.mode != OFFBOARD:
            return _takeover(f"the autopilot was switched to {vehicle.mode}", vehicle)
        if vehicle.armed and vehicle.foreign_setpoints:
            return _takeover("the autopilot follows setpoints of somebody else", vehicle)
        return None

    def while_idle(self, vehicle: VehicleSnapshot, *, was_disarmed: bool) -> Takeover | None:
        """Takeover while the bridge is idle, None without one.

        Args:
            was_disarmed: the vehicle has been disarmed since the bridge started.
        """
        if not vehicle.armed:
            return None
        if was_disarmed:
            return _takeover("armed, and not by the bridge", vehicle)
        if vehicle.failsafe or vehicle.mode == OFFBOARD:
            return "failsafe", "the vehicle was armed already when the bridge started"
        return _takeover(f"the vehicle flew already, in {vehicle.mode}, when the bridge started", vehicle)

    def handover(self, vehicle: VehicleSnapshot) -> Takeover | None:
        """Handover between a pilot and a failsafe while others fly, None without one."""
        previous, self._external_mode = self._external_mode, (vehicle.mode, vehicle.failsafe)
        if self._external_mode == previous or not previous[0] or not vehicle.armed:
            return None
        if vehicle.failsafe:
            return "failsafe", f"a failsafe switched the autopilot to {vehicle.mode}"
        return "external", f"somebody switched the autopilot to {vehicle.mode}"


def _takeover(event: str, vehicle: VehicleSnapshot) -> Takeover:
    """Takeover through an event that a failsafe, a pilot or another program caused."""
    if vehicle.failsafe:
        because = f" ({vehicle.command_failure})" if vehicle.command_failure else ""
        return "failsafe", f"failsafe: {event}{because}"
    return "external", f"taken over: {event}"
