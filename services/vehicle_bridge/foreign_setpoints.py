"""Detection of foreign setpoints. In offboard mode the autopilot follows them without a change of mode.

The autopilot echoes the setpoint that it follows in POSITION_TARGET_LOCAL_NED. PX4 echoes a position as it was sent,
and a velocity after its own limits; on the ground it echoes nothing. So an echoed position must be one that was sent
lately, and an echoed velocity no greater than one that was. Two streams alternate: foreign echoes are counted, they
need not follow each other.
"""

from collections import deque
from math import dist, isnan

import msgspec

from jezero.frames import Vec3
from jezero.services.vehicle_bridge.vehicle import Target

SENT_MAX_AGE_NS = 1_000_000_000
"""A setpoint sent this long ago may still be echoed: latency, and positions moved by a reset."""
ECHO_MAX_AGE_NS = 300_000_000
"""An older echo is ignored: it may have been late on a link that was down."""
FOREIGN_WINDOW_NS = 2_000_000_000
FOREIGN_SETPOINTS_MIN = 4
FOREIGN_SPAN_MIN_NS = 500_000_000
"""Fewer foreign echoes in the window, or a shorter burst, may be late echoes of our own setpoints."""
POS_TOLERANCE_M = 0.1
VEL_TOLERANCE_MPS = 0.2


class SetpointEcho(msgspec.Struct, frozen=True):
    """One POSITION_TARGET_LOCAL_NED: the setpoint that the autopilot follows.

    Attributes:
        t_ns: vehicle time.
        pos_ned_m: position, with NaN in each axis that isn't controlled by position.
        vel_ned_mps: velocity, with NaN in each axis that isn't controlled by velocity.
    """

    t_ns: int
    pos_ned_m: Vec3
    vel_ned_mps: Vec3


class ForeignSetpointDetector:
    """Detects that somebody else streams setpoints too."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, Target]] = deque()
        self._foreign_ns: deque[int] = deque()

    def reset(self) -> None:
        """Start again, as when the bridge's own stream ends."""
        self._sent.clear()
        self._foreign_ns.clear()

    def add_sent(self, target: Target, timer_ns: int) -> None:
        """Remember a setpoint that the bridge has sent."""
        self._sent.append((timer_ns, target))
        while self._sent[0][0] < timer_ns - SENT_MAX_AGE_NS:
            self._sent.popleft()

    def update(self, echo: SetpointEcho, t_ns: int, timer_ns: int) -> None:
        """Compare an echo with the setpoints sent during the last second."""
        pos_ned_m, vel_ned_mps = echo.pos_ned_m, echo.vel_ned_mps
        if not self._sent or t_ns - echo.t_ns > ECHO_MAX_AGE_NS or all(map(isnan, pos_ned_m + vel_ned_mps)):
            return
        if not any(_may_be_echo(echo, target) for _, target in reversed(self._sent)):
            self._foreign_ns.append(timer_ns)

    def is_detected(self, timer_ns: int) -> bool:
        """Whether somebody else streams setpoints."""
        foreign_ns = self._foreign_ns
        while foreign_ns and foreign_ns[0] < timer_ns - FOREIGN_WINDOW_NS:
            foreign_ns.popleft()
        return len(foreign_ns) >= FOREIGN_SETPOINTS_MIN and foreign_ns[-1] - foreign_ns[0] >= FOREIGN_SPAN_MIN_NS


def _may_be_echo(echo: SetpointEcho, sent: Target) -> bool:
    """Whether the autopilot may echo this target so."""
    if sent.pos_ned_m is not None:
        return dist(sent.pos_ned_m, echo.pos_ned_m) <= POS_TOLERANCE_M
    if sent.vel_ned_mps is None or not all(map(isnan, echo.pos_ned_m)):
        return False
    return all(map(_is_limited, echo.vel_ned_mps, sent.vel_ned_mps))


def _is_limited(echo_mps: float, sent_mps: float) -> bool:
    """Whether one component of an echo is the sent one, or lies between it and zero."""
    low_mps, high_mps = min(0.0, sent_mps), max(0.0, sent_mps)
    return low_mps - VEL_TOLERANCE_MPS <= echo_mps <= high_mps + VEL_TOLERANCE_MPS
