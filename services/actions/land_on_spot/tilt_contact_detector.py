"""Whether what a landing touches is an edge or a rock, which the vehicle leans over; and whether it stands at last."""

from math import degrees

from jezero.frames import tilt_from_quat
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.behaviour import Done, VehicleState
from jezero.tilt_contact import is_tilted_by_contact

DESCENT_DONE = 0.5
HELD_S = 0.2
"""Something holds the vehicle when it descends at less than that share of the wanted speed for so long."""
RELEASED_S = 0.2
"""And counts for so long afterwards: whoever falls over descends again."""
TAU_S = 0.5
"""Of the lean in the air."""
STEP_MAX_S = 0.1
FALLEN_RAD = 0.52
"""Whoever leans by more doesn't stand."""


def standing(state: VehicleState) -> Done:
    """The end of a landing when the autopilot sees the ground."""
    tilt_rad = tilt_from_quat(state.q_ned_from_frd)
    if tilt_rad > FALLEN_RAD:
        return Done("aborted", f"the vehicle fell over: it leans by {degrees(tilt_rad):.0f} degrees", "disarm")
    return Done("succeeded", then="disarm")


class Edge:
    """Compares the lean of a vehicle that is held with its lean in the air."""

    def __init__(self) -> None:
        self._air_ned: tuple[float, float] | None = None
        self._t_ns = self._moved_ns = 0
        self._held_ns: int | None = None

    def is_below(self, t_ns: int, state: VehicleState, down_wanted_mps: float) -> bool:
        """Take in the newest state of a vehicle that shall descend; whether it leans over what holds it."""
        passed_s = min(max((t_ns - self._t_ns) / NS_PER_S, 0.0), STEP_MAX_S)
        self._t_ns = t_ns
        if self._air_ned is None or state.vel_uav_ned_mps[2] >= DESCENT_DONE * down_wanted_mps:
            self._moved_ns = t_ns
        if t_ns - self._moved_ns >= HELD_S * NS_PER_S:
            self._held_ns = t_ns
        if self._held_ns is not None and t_ns - self._held_ns <= RELEASED_S * NS_PER_S:
            return self._air_ned is not None and is_tilted_by_contact(state.down_ned, self._air_ned)
        self._held_ns = None
        north, east = self._air_ned or state.down_ned
        share = passed_s / TAU_S
        self._air_ned = (north + share * (state.down_ned[0] - north), east + share * (state.down_ned[1] - east))
        return False
