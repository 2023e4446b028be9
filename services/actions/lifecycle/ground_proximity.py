"""Protection of a goal's flight against the ground, whatever altitude the autopilot has estimated.

A barometer that is wrong by some metres moves the autopilot's altitude by as much. A target at a safe altitude is then
in the ground. The laser altimeter shows it in time.
"""

from jezero.frames import norm
from jezero.schemas.commands import Phase
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import Move, VehicleState
from jezero.vehicle_config import VehicleConfig

CLEARANCE_MIN_M = 0.25
"""Least height of the feet over ground or platform in a flight that is no takeoff or landing."""
BRAKING_MPS2 = 1.5
"""Deceleration of the descent that a hover reaches; above the clearance there must be room for it."""
STANDING_CLEARANCE_M, STANDING_SPEED_MPS = 0.1, 0.1
"""A vehicle that is lower and slower than this stands, and must not be moved along the ground."""
LOW_MIN_S = 0.15
"""A vehicle that is low for a shorter time isn't judged: single readings may be wrong."""


class GroundProximity:
    """Detects that the flight of a goal leads into the ground, by the altimeter alone.

    Args:
        vehicle: has the mounting height of the altimeter.
    """

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._height_altimeter_m = vehicle.height_altimeter_m
        self._low_since_ns: int | None = None

    def problem(self, t_ns: int, state: VehicleState, move: Move) -> str:
        """Add the newest state; returns the reason why the goal must end, or "".

        Without a reading of the altimeter nothing changes: a vehicle that stands is too low for it.
        """
        if move.phase in (Phase.TAKEOFF, Phase.LANDING):
            self._low_since_ns = None
            return ""
        if state.height_m is None:
            return ""
        clearance_m = state.height_m - self._height_altimeter_m
        if not self._is_low(clearance_m, state):
            self._low_since_ns = None
        elif self._low_since_ns is None:
            self._low_since_ns = t_ns
        if self._low_since_ns is None or t_ns - self._low_since_ns < LOW_MIN_S * NS_PER_S:
            return ""
        return (
            f"the altimeter measures only {max(clearance_m, 0.0):.1f} m below the vehicle's feet, and the goal leads "
            "down: is the altitude of the autopilot right, and the ground as high as expected?"
        )

    def _is_low(self, clearance_m: float, state: VehicleState) -> bool:
        """Whether the vehicle can't stop its descent above the least clearance, or stands."""
        down_mps = state.vel_uav_ned_mps[2]
        if clearance_m < STANDING_CLEARANCE_M and norm(state.vel_uav_ned_mps) < STANDING_SPEED_MPS:
            return True
        braking_m = down_mps * down_mps / (2.0 * BRAKING_MPS2)
        return down_mps > 0.0 and clearance_m < CLEARANCE_MIN_M + braking_m
