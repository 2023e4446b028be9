"""A line that is too narrow for ODOMETRY: how often odometry comes, and odometry made of two smaller messages.

ODOMETRY has 244 bytes. LOCAL_POSITION_NED and ATTITUDE_QUATERNION have 84 together, but no reset counter and no
covariance: a step of the position estimate is found by what the velocity doesn't explain.
"""

from collections import deque

from jezero.base.frames import Quat, Vec3, add, norm, quat_from_rotation_vector, quat_multiply, scale, subtract
from jezero.schemas.units import NS_PER_S

RATE_MIN_HZ = 20.0
"""A line that carries ODOMETRY less often is too narrow for it; position and attitude reach 30 Hz at 57600 baud."""
ROUND_TRIP_MAX_NS = 50_000_000
"""A line that answers no sooner is full: what it carries is old."""
WINDOW_NS = 3 * NS_PER_S
JUDGED_AFTER_NS = 6 * NS_PER_S
"""Time from the first message on the line until the rate is judged: the controller gets the request for rates first."""
STEP_MIN_M = 0.5
"""A change of position that the velocity doesn't explain is a step of the estimate from this size on."""
ACCELERATION_MAX_MPS2 = 10.0
"""The vehicle itself may change its velocity this fast between two positions, of which some may be lost: beyond the
tilt of any multicopter that flies on."""
PAIR_AGE_MAX_NS = 150_000_000
"""Longest time between the attitude and the position of a pair."""


def rate_refusal(hz: float | None, needed_hz: float, action: str, line: str) -> str:
    """Reason why odometry comes too rarely for an action, with what to do, or "".

    Args:
        hz: rate of odometry; None where it isn't judged, or it is too early.
        needed_hz: rate that the action needs.
        action: its name for people.
        line: the link to the flight controller, as in the settings.
    """
    if hz is None or hz >= needed_hz:
        return ""
    faster = "raise MAV_2_RATE, or use a better network"
    if line.startswith("serial:"):
        faster = (
            "raise PX4's SER_TEL2_BAUD and MAV_1_RATE (at TELEM1 SER_TEL1_BAUD and MAV_0_RATE), or use USB or Ethernet"
        )
    return f"odometry comes at {hz:.0f} Hz over {line}, and {action} needs {needed_hz:g} Hz: {faster}"


class OdometryRate:
    """Measures how often odometry arrives, and whether the line is too narrow for it.

    Attributes:
        narrow: whether odometry is made of the two smaller messages.
        hz: odometry per second; None while it is too early to judge.
    """

    def __init__(self) -> None:
        self.narrow = False
        self.hz: float | None = None
        self._arrivals_ns: deque[int] = deque()
        self._since_ns: int | None = None

    def add(self, wall_ns: int) -> None:
        """Count an odometry that has arrived."""
        self._arrivals_ns.append(wall_ns)

    def update(self, wall_ns: int, round_trip_ns: int | None) -> bool:
        """Judge the rate, while telemetry arrives; returns whether the line has just been found too narrow.

        Args:
            wall_ns: this computer's monotonic time.
            round_trip_ns: shortest time from a request to its reply; None while it isn't known.
        """
        if self._since_ns is None:
            self._since_ns = wall_ns
        while self._arrivals_ns and wall_ns - self._arrivals_ns[0] > WINDOW_NS:
            self._arrivals_ns.popleft()
        if wall_ns - self._since_ns < JUDGED_AFTER_NS:
            return False
        self.hz = len(self._arrivals_ns) * NS_PER_S / WINDOW_NS
        full = round_trip_ns is not None and round_trip_ns > ROUND_TRIP_MAX_NS
        if self.narrow or (self.hz >= RATE_MIN_HZ and not full):
            return False
        self.narrow = True
        self.restart()
        return True

    def restart(self) -> None:
        """Judge anew, as the line was interrupted or the controller was booted anew."""
        self._arrivals_ns.clear()
        self._since_ns = self.hz = None


class PairedOdometry:
    """Makes odometry of an attitude and a position.

    Attributes:
        reset_counter: number of steps of the position estimate that were found, 0–255.
    """

    def __init__(self) -> None:
        self.reset_counter = 0
        self._attitude: tuple[int, Quat, Vec3] | None = None
        self._position: tuple[int, Vec3, Vec3] | None = None

    def on_attitude(self, t_ns: int, q_ned_from_frd: Quat, rates_frd_rps: Vec3) -> None:
        """Keep the newest attitude."""
        self._attitude = (t_ns, q_ned_from_frd, rates_frd_rps)

    def on_position(self, t_ns: int, pos_ned_m: Vec3, vel_ned_mps: Vec3) -> tuple[Quat, Vec3] | None:
        """Attitude and body rates at the time of a position; None without a young attitude."""
        last, self._position = self._position, (t_ns, pos_ned_m, vel_ned_mps)
        if last is not None:
            passed_s = (t_ns - last[0]) / NS_PER_S
            expected = add(last[1], scale(last[2], passed_s))
            own_m = 0.5 * ACCELERATION_MAX_MPS2 * passed_s * passed_s
            if norm(subtract(pos_ned_m, expected)) > STEP_MIN_M + own_m:
                self.reset_counter = (self.reset_counter + 1) % 256
        if self._attitude is None or abs(t_ns - self._attitude[0]) > PAIR_AGE_MAX_NS:
            return None
        attitude_ns, q, rates_rps = self._attitude
        turned = quat_from_rotation_vector(scale(rates_rps, (t_ns - attitude_ns) / NS_PER_S))
        return quat_multiply(q, turned), rates_rps
