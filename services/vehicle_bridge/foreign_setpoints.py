"""Whose setpoints the autopilot follows. In offboard mode, foreign ones need no change of mode to be flown.

The autopilot tells what it follows in POSITION_TARGET_LOCAL_NED. PX4 repeats a position as it was sent, and a velocity
after its own limits; on the ground it tells nothing. So a position must be one that was sent lately, a velocity no
greater than one that was. Two streams alternate: it is the number of strangers that tells, not an unbroken row.
"""

from collections import deque
from math import dist, isnan

from jezero.frames import Vec3
from jezero.services.vehicle_bridge.vehicle import Target

SENT_WITHIN_NS = 1_000_000_000
"""What was sent this long before may still be followed: latency, and positions moved by a reset."""
MAX_AGE_NS = 300_000_000
"""What was told longer ago than this is no news; it may have been late on a link that was down."""
WITHIN_NS = 2_000_000_000
STRANGERS = 4
SPAN_NS = 500_000_000
"""So many strangers within the first time, spread over the second, are somebody else's stream."""
POS_TOLERANCE_M = 0.1
VEL_TOLERANCE_MPS = 0.2


class Followed:
    """Compares what the autopilot follows with what was sent."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, Target]] = deque()
        self._strangers: deque[int] = deque()

    def forget(self) -> None:
        """Nothing is streamed any more, or it begins anew."""
        self._sent.clear()
        self._strangers.clear()

    def send(self, target: Target, timer_ns: int) -> None:
        """One setpoint was sent."""
        self._sent.append((timer_ns, target))
        while self._sent[0][0] < timer_ns - SENT_WITHIN_NS:
            self._sent.popleft()

    def tell(self, pos_ned_m: Vec3, vel_ned_mps: Vec3, age_ns: int, timer_ns: int) -> None:
        """The autopilot tells what it followed `age_ns` ago; NaN is what it doesn't control."""
        if not self._sent or age_ns > MAX_AGE_NS or all(map(isnan, pos_ned_m + vel_ned_mps)):
            return
        if not any(_explains(target, pos_ned_m, vel_ned_mps) for _, target in reversed(self._sent)):
            self._strangers.append(timer_ns)

    def by_others(self, timer_ns: int) -> bool:
        """Whether somebody else streams setpoints as well."""
        strangers = self._strangers
        while strangers and strangers[0] < timer_ns - WITHIN_NS:
            strangers.popleft()
        return len(strangers) >= STRANGERS and strangers[-1] - strangers[0] >= SPAN_NS


def _explains(target: Target, pos_ned_m: Vec3, vel_ned_mps: Vec3) -> bool:
    """Whether an autopilot that was sent this target may follow that."""
    if target.pos_ned_m is not None:
        return dist(target.pos_ned_m, pos_ned_m) <= POS_TOLERANCE_M
    if target.vel_ned_mps is None or not all(map(isnan, pos_ned_m)):
        return False
    return all(_is_limited(told, sent) for told, sent in zip(vel_ned_mps, target.vel_ned_mps, strict=True))


def _is_limited(told_mps: float, sent_mps: float) -> bool:
    """Whether one component is the sent one, or lies between it and rest."""
    low_mps, high_mps = min(0.0, sent_mps), max(0.0, sent_mps)
    return low_mps - VEL_TOLERANCE_MPS <= told_mps <= high_mps + VEL_TOLERANCE_MPS
