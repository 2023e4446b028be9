"""Plausibility check of the rover's odometry.

The relative position from UWB is rotated by the rover's heading, so a heading that jumps must not be used.
"""

from jezero.base.frames import wrap_pi
from jezero.schemas.sensors import RoverOdometry

REJECT_AFTER_JUMP_NS = 500_000_000
"""After an implausible reading all readings are rejected for this time."""
SPEED_MAX_MPS = 6.0
ACC_MAX_MPS2, SPEED_STEP_MPS = 3.0, 0.3
YAW_RATE_MAX_RPS, YAW_STEP_RAD = 2.0, 0.3
"""Greatest change between two readings: a limit on the rate, and a step that allows for noise."""


class RoverPlausibilityCheck:
    """Rejects readings that a rover cannot have reached from the reading before."""

    def __init__(self) -> None:
        self._last: RoverOdometry | None = None
        self._reject_until_ns = 0

    def clear(self) -> None:
        """Reset: the next reading may have any heading."""
        self._last = None
        self._reject_until_ns = 0

    def is_plausible(self, reading: RoverOdometry) -> bool:
        """Whether this reading and all those of the last half second are plausible."""
        last = self._last
        if last is None or reading.t_ns > last.t_ns:
            self._last = reading
        if not (abs(reading.speed_rover_body_mps) <= SPEED_MAX_MPS and (last is None or _is_reachable(last, reading))):
            self._reject_until_ns = max(self._reject_until_ns, reading.t_ns + REJECT_AFTER_JUMP_NS)
        return reading.t_ns >= self._reject_until_ns


def _is_reachable(one: RoverOdometry, other: RoverOdometry) -> bool:
    dt_s = abs(other.t_ns - one.t_ns) * 1e-9
    turned_rad = abs(wrap_pi(other.yaw_rover_rad - one.yaw_rover_rad))
    faster_mps = abs(other.speed_rover_body_mps - one.speed_rover_body_mps)
    return turned_rad <= YAW_RATE_MAX_RPS * dt_s + YAW_STEP_RAD and faster_mps <= ACC_MAX_MPS2 * dt_s + SPEED_STEP_MPS
