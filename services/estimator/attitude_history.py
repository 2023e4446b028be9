"""The vehicle's attitude at any time of the last second."""

from bisect import bisect_left
from collections import deque

from jezero.base.frames import Quat, quat_from_rotation_vector, quat_multiply, quat_normalize, scale
from jezero.schemas.state import Odometry
from jezero.schemas.units import NS_PER_S

HISTORY_LENGTH = 100


class AttitudeHistory:
    """A short history of the autopilot's attitude.

    Args:
        age_max_s: greatest time between a requested time and the nearest odometry message.
    """

    def __init__(self, age_max_s: float) -> None:
        self._age_max_s = age_max_s
        self._known: deque[Odometry] = deque(maxlen=HISTORY_LENGTH)

    def add(self, odometry: Odometry) -> None:
        """Store a message that is newer than all before it; a new epoch clears the history."""
        if self._known and odometry.epoch_id != self._known[-1].epoch_id:
            self._known.clear()
        if not self._known or odometry.t_ns > self._known[-1].t_ns:
            self._known.append(odometry)

    def at(self, t_ns: int) -> Quat | None:
        """Attitude at `t_ns`, extrapolated from the nearest message by its body rates; None when too far away."""
        if not self._known:
            return None
        after = bisect_left(self._known, t_ns, key=lambda odometry: odometry.t_ns)
        candidates = [self._known[i] for i in (after - 1, after) if 0 <= i < len(self._known)]
        nearest = min(candidates, key=lambda odometry: abs(odometry.t_ns - t_ns))
        dt_s = (t_ns - nearest.t_ns) / NS_PER_S
        if abs(dt_s) > self._age_max_s:
            return None
        turn = quat_from_rotation_vector(scale(nearest.rates_uav_frd_rps, dt_s))
        return quat_normalize(quat_multiply(nearest.q_ned_from_frd, turn))
