"""Conditions and time-outs of a flight: its way into offboard mode, what ends it, and the disarming after it."""

from math import degrees

from jezero.base.frames import horizontal, norm, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.services.vehicle_bridge.admission import force_disarm_refusal
from jezero.services.vehicle_bridge.vehicle import LINK_TIMEOUT_S, OFFBOARD, AutopilotCommand, Target, VehicleSnapshot

STREAM_LEAD_S = 0.2
"""Setpoints are streamed for this time before the autopilot is commanded into offboard mode."""
ENGAGE_TIMEOUT_S = 5.0
"""Time-out of offboard mode and arming together."""
TILT_LIMIT_RAD, TILT_TIMEOUT_S = 1.0472, 0.5
"""A vehicle that is tilted further than 60 degrees for this time is upside down or lies against something: no
controller tilts it as far."""
WEDGED_HEIGHT_MAX_M, WEDGED_TIMEOUT_S = 1.0, 5.0
"""Something holds a vehicle that stands still for this time near the ground although its target is elsewhere. The tilt
is no sign of a wedge: a vehicle that hangs with a rotor under the rover's platform is nearly level."""
STILL_MPS = 0.1
COMMANDED_MIN_MPS, AWAY_MIN_M = 0.3, 0.5
"""A vehicle whose target is faster than this, or farther away, should not stand still."""
BLIND_TIMEOUT_S = 5.0
"""Without telemetry for this time, the bridge stops streaming, and the autopilot lands by itself."""
DISARM_TIMEOUT_S = 10.0
"""Time-out of a normal disarm on the ground: the autopilot must first detect the ground."""


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


class FlightMonitor:
    """Detects what ends a flight: tilt, a wedge, and the loss of telemetry or of the bus's router.

    Each method but `update` returns a reason, or "".

    Args:
        router_timeout_s: the vehicle lands when the router has been missing for longer.
    """

    def __init__(self, router_timeout_s: float) -> None:
        self._router_timeout_s = router_timeout_s
        self._upright_ns = self._free_ns = 0

    def update(self, vehicle: VehicleSnapshot, target: Target | None, *, flying: bool) -> None:
        """Measure since when the vehicle is tilted too far, or wedged, while the bridge flies it.

        Args:
            target: that the autopilot follows.
        """
        flying = flying and bool(vehicle.armed)
        if not (flying and vehicle.tilt_rad > TILT_LIMIT_RAD):
            self._upright_ns = vehicle.timer_ns
        if not (flying and _is_held(vehicle, target)):
            self._free_ns = vehicle.timer_ns

    def kill_reason(self, vehicle: VehicleSnapshot) -> str:
        """Reason to cut the motors."""
        tilt = f"tilted by {degrees(vehicle.tilt_rad):.0f} degrees"
        tilted_s = (vehicle.timer_ns - self._upright_ns) * 1e-9 - vehicle.telemetry_age_s  # until the last measurement
        if tilted_s >= TILT_TIMEOUT_S:
            return f"motors cut: {tilt} for {TILT_TIMEOUT_S:g} s"
        if (vehicle.timer_ns - self._free_ns) * 1e-9 >= WEDGED_TIMEOUT_S:
            return (
                f"motors cut: the vehicle is wedged near the ground, {tilt}, and has not moved for "
                f"{WEDGED_TIMEOUT_S:g} s although it was commanded to; free it from what holds it, such as the edge "
                "of the rover's platform, and check rotors and payload"
            )
        return ""

    def link_reason(self, vehicle: VehicleSnapshot) -> str:
        """Reason to end a goal."""
        age_s = vehicle.telemetry_age_s
        return f"no telemetry for {age_s:.1f} s" if age_s > LINK_TIMEOUT_S else ""

    def blind_reason(self, vehicle: VehicleSnapshot) -> str:
        """Reason to stop streaming."""
        age_s = vehicle.telemetry_age_s
        if age_s <= BLIND_TIMEOUT_S:
            return ""
        return f"no telemetry for {age_s:.1f} s: left to the autopilot's failsafe"

    def router_reason(self, vehicle: VehicleSnapshot) -> str:
        """Reason to land."""
        lost_s = vehicle.router_lost_s
        if lost_s < self._router_timeout_s or not vehicle.armed or vehicle.landed:
            return ""
        return f"landing: the bus's router has been missing for {lost_s:.0f} s"


def _is_held(vehicle: VehicleSnapshot, target: Target | None) -> bool:
    """Whether the vehicle stands still near the ground, although the autopilot follows a target that is elsewhere.

    A command that only pushes the vehicle down doesn't count: a vehicle that has landed on a slope obeys it.
    """
    if target is None or vehicle.pos_ned_m is None or vehicle.height_m is None:
        return False
    follows = vehicle.mode == OFFBOARD and vehicle.telemetry_age_s < LINK_TIMEOUT_S
    still = norm(vehicle.vel_ned_mps) < STILL_MPS and vehicle.height_m < WEDGED_HEIGHT_MAX_M
    if vehicle.landed or not follows or not still:
        return False
    if target.pos_ned_m is None:
        assert target.vel_ned_mps is not None, "a target has a position or a velocity"
        return max(horizontal(target.vel_ned_mps), -target.vel_ned_mps[2]) > COMMANDED_MIN_MPS
    away_m = subtract(target.pos_ned_m, vehicle.pos_ned_m)
    return max(horizontal(away_m), -away_m[2]) > AWAY_MIN_M


class Disarming:
    """Chooses the command that stops the motors on the ground.

    Attributes:
        by_force: the finished landing detected the ground, although the autopilot's land detector did not.
    """

    def __init__(self, robot: VehicleConfig) -> None:
        self.by_force = False
        self._robot = robot

    def command(self, vehicle: VehicleSnapshot) -> AutopilotCommand:
        """The command to the autopilot."""
        by_force = self.by_force and not vehicle.landed and not force_disarm_refusal(vehicle, self._robot)
        return AutopilotCommand.FORCE_DISARM if by_force else AutopilotCommand.DISARM

    def overdue_reason(self, vehicle: VehicleSnapshot, elapsed_s: float) -> str:
        """Reason to leave the vehicle to the autopilot, or ""."""
        if elapsed_s <= DISARM_TIMEOUT_S:
            return ""
        return f"the autopilot did not disarm within {elapsed_s:.0f} s: {vehicle.failure_reason}"
