"""Whether the rover's odometry is a rover's: the heading turns everything that UWB tells, so none may be believed that
jumps about."""

from jezero.frames import wrap_pi
from jezero.schemas.sensors import RoverOdometry

DISTRUST_NS = 500_000_000
"""After a reading that can't be, none is believed for so long."""
SPEED_MAX_MPS = 3.0
ACC_MAX_MPS2, SPEED_STEP_MPS = 3.0, 0.3
YAW_RATE_MAX_RPS, YAW_STEP_RAD = 2.0, 0.3
"""From one reading to the next: what a rover can do in that time, and what noise adds."""


class RoverScreen:
    """Compares each reading with the one before it."""

    def __init__(self) -> None:
        self._last: RoverOdometry | None = None
        self._believed_from_ns = 0

    def clear(self) -> None:
        """Forget the readings: the next one may be any."""
        self._last = None
        self._believed_from_ns = 0

    def believes(self, reading: RoverOdometry) -> bool:
        """Whether this reading, and those of the last half second, can be a rover's."""
        last = self._last
        if last is None or reading.t_ns > last.t_ns:
            self._last = reading
        if not (abs(reading.speed_rover_body_mps) <= SPEED_MAX_MPS and (last is None or _agree(last, reading))):
            self._believed_from_ns = max(self._believed_from_ns, reading.t_ns + DISTRUST_NS)
        return reading.t_ns >= self._believed_from_ns


def _agree(one: RoverOdometry, other: RoverOdometry) -> bool:
    dt_s = abs(other.t_ns - one.t_ns) * 1e-9
    turned_rad = abs(wrap_pi(other.yaw_rover_rad - one.yaw_rover_rad))
    faster_mps = abs(other.speed_rover_body_mps - one.speed_rover_body_mps)
    return turned_rad <= YAW_RATE_MAX_RPS * dt_s + YAW_STEP_RAD and faster_mps <= ACC_MAX_MPS2 * dt_s + SPEED_STEP_MPS
