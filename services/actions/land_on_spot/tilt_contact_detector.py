"""Detection of an edge or a rock under a landing vehicle, which tilts over it; and the outcome of a landing."""

from math import degrees

from jezero.frames import tilt_from_quat
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import Done, VehicleState
from jezero.tilt_contact import is_tilted_by_contact

STALLED_SPEED_RATIO = 0.5
"""A vehicle is stalled while it descends at less than this ratio of the commanded speed."""
STALLED_MIN_S = 0.2
"""A shorter stall may be a gust, and doesn't count as contact."""
CONTACT_MEMORY_S = 0.2
"""Contact lasts for this time after the stall, because a vehicle that falls over an edge descends again."""
TILT_FILTER_TIME_CONSTANT_S = 0.5
STEP_MAX_S = 0.1
FALLEN_TILT_RAD = 0.52
"""A vehicle with a larger tilt than this has fallen over."""


def landing_outcome(state: VehicleState) -> Done:
    """End of a landing when the autopilot has detected the ground."""
    tilt_rad = tilt_from_quat(state.q_ned_from_frd)
    if tilt_rad > FALLEN_TILT_RAD:
        return Done("aborted", f"the vehicle fell over: it is tilted by {degrees(tilt_rad):.0f} degrees", "disarm")
    return Done("succeeded", then="disarm")


class TiltContactDetector:
    """Detects that a descending vehicle tilts over something, by comparing its tilt with that in free flight."""

    def __init__(self) -> None:
        self._free_tilt_ned: tuple[float, float] | None = None
        self._t_ns = self._moved_ns = 0
        self._contact_ns: int | None = None
        self._tilted = False

    @property
    def free_down_ned(self) -> tuple[float, float]:
        """(2,) the tilt in free flight, see `VehicleState.down_ned`."""
        return self._free_tilt_ned or (0.0, 0.0)

    def update(self, t_ns: int, state: VehicleState, down_commanded_mps: float) -> bool:
        """Add the state of a vehicle that is commanded to descend; returns whether it tilts over an obstacle."""
        passed_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        if self._free_tilt_ned is None or state.vel_uav_ned_mps[2] >= STALLED_SPEED_RATIO * down_commanded_mps:
            self._moved_ns, self._tilted = t_ns, False
        if self._free_tilt_ned is not None and is_tilted_by_contact(state.down_ned, self._free_tilt_ned):
            self._tilted = True
        if t_ns - self._moved_ns >= STALLED_MIN_S * NS_PER_S:
            self._contact_ns = t_ns
        if self._contact_ns is not None and t_ns - self._contact_ns <= CONTACT_MEMORY_S * NS_PER_S:
            return self._tilted
        self._contact_ns = None
        north, east = self._free_tilt_ned or state.down_ned
        weight = passed_s / TILT_FILTER_TIME_CONSTANT_S
        self._free_tilt_ned = (
            north + weight * (state.down_ned[0] - north),
            east + weight * (state.down_ned[1] - east),
        )
        return False
