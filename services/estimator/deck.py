"""Finds out whether the rover's platform heaves and tilts, as a boat's deck or a rover on rocks, and how much.

The filter holds a rover that stands still, or drives on even ground, to a vertical speed near 0: so a landing on the
ground is precise. On a deck this would make UWB and tag contradict the estimate. The monitor uses what measures the
deck directly, not the filter's estimate of the deck: the rover's IMU, and the height by the tags. The height by UWB is
not used: an error that all ranges share changes this height when the vehicle moves. The filter changes its motion model
when the deck moves.
"""

from collections import deque
from math import hypot, sqrt

import numpy as np

from jezero.schemas.estimate import DeckMotion
from jezero.schemas.units import NS_PER_S

TILT_WINDOW_NS = 2 * NS_PER_S
TILT_CHANGE_MIN_RAD = 0.02
"""The deck moves when its tilt by the rover's IMU changes by this within TILT_WINDOW_NS: four times the IMU's noise."""
HEIGHT_WINDOW_NS = NS_PER_S
CLIMB_MIN_MPS, CLIMB_SIGMAS, EXPLAINED_MIN = 0.1, 5.0, 0.95
"""The deck moves when its height by the tags changes faster than this, and than this number of the speed's standard
deviations, over the time above, and evenly: the speed explains this share of the heights' variance."""
SAMPLES_MIN, STD_SAMPLE_MAX_M = 8, 0.15
STILL_AFTER_NS = 20 * NS_PER_S
"""The deck counts as still after this time without a sign that it moves: longer than the calm between two groups of
waves."""
TILT_RATE_NS = 3 * NS_PER_S // 10
"""The rates of roll and pitch are measured over this time."""
MOTION_WINDOW_NS, MOTION_PERIOD_NS = 30 * NS_PER_S, NS_PER_S // 10
"""What the deck did within this time says what it may do next."""
STD_CLIMB_MAX_MPS = 0.3
"""The motion counts as observed while its vertical speed is known to this."""


class DeckMonitor:
    """Watches the deck.

    Args:
        always: whether the deck moves all the time, whatever is measured.

    Attributes:
        moves: whether the deck moves.
    """

    def __init__(self, *, always: bool = False) -> None:
        self._always = always
        self._tilts: deque[tuple[int, float, float]] = deque()
        self._heights: deque[tuple[int, float, float]] = deque()
        self._motion: deque[tuple[int, float, float]] = deque()
        self.restart()

    def restart(self) -> None:
        """Forget everything, as in a new epoch, whose time may have begun anew."""
        self.moves = self._always
        self._moved_ns = 0
        for samples in (self._tilts, self._heights, self._motion):
            samples.clear()

    def add_tilt(self, t_ns: int, roll_rad: float, pitch_rad: float) -> None:
        """Add the platform's attitude by the rover's IMU."""
        _append(self._tilts, (t_ns, roll_rad, pitch_rad), TILT_WINDOW_NS)
        _, rolls_rad, pitches_rad = zip(*self._tilts, strict=True)
        change_rad = hypot(max(rolls_rad) - min(rolls_rad), max(pitches_rad) - min(pitches_rad))
        if change_rad > TILT_CHANGE_MIN_RAD:
            self._note(t_ns)
        elif t_ns - self._moved_ns > STILL_AFTER_NS:
            self.moves = self._always

    def add_height(self, t_ns: int, down_m: float, std_m: float) -> None:
        """Add the platform's height as the tags measure it from the vehicle, whose height the autopilot knows.

        Args:
            down_m: in the vehicle's world frame, positive down.
            std_m: standard deviation.
        """
        if std_m > STD_SAMPLE_MAX_M:
            return
        heights = self._heights
        _append(heights, (t_ns, down_m, std_m), HEIGHT_WINDOW_NS)
        if len(heights) < SAMPLES_MIN or t_ns - heights[0][0] < 0.6 * HEIGHT_WINDOW_NS:
            return
        times_ns, downs_m, stds_m = (np.array(column) for column in zip(*heights, strict=True))
        times_s = (times_ns - t_ns) / NS_PER_S
        times_s -= times_s.mean()
        downs_m -= downs_m.mean()
        spread_s2 = float(times_s @ times_s)
        climb_mps = float(times_s @ downs_m) / spread_s2
        std_climb_mps = float(stds_m.mean()) / sqrt(spread_s2)
        even = climb_mps**2 * spread_s2 > EXPLAINED_MIN * float(downs_m @ downs_m)
        if even and abs(climb_mps) > max(CLIMB_MIN_MPS, CLIMB_SIGMAS * std_climb_mps):
            self._note(t_ns)

    def add_motion(self, t_ns: int, down_mps: float, std_mps: float) -> None:
        """Add the filter's estimate of the deck's vertical speed, positive down, and its standard deviation."""
        if std_mps > STD_CLIMB_MAX_MPS:
            return
        if not self._motion or t_ns - self._motion[-1][0] >= MOTION_PERIOD_NS:
            _, roll_rad, pitch_rad = self._tilts[-1] if self._tilts else (0, 0.0, 0.0)
            _append(self._motion, (t_ns, down_mps, hypot(roll_rad, pitch_rad)), MOTION_WINDOW_NS)

    def motion(self, acc_down_mps2: float) -> DeckMotion | None:
        """How the deck moves; None for a still deck, and at first.

        Args:
            acc_down_mps2: the filter's estimate of the deck's vertical acceleration, positive down.
        """
        if not self.moves or len(self._motion) < 2:
            return None
        times_ns, speeds_mps, tilts_rad = (np.array(column) for column in zip(*self._motion, strict=True))
        roll_rad, pitch_rad, roll_rate_rps, pitch_rate_rps = self._newest_tilt()
        return DeckMotion(
            acc_down_mps2=acc_down_mps2,
            roll_rad=roll_rad,
            pitch_rad=pitch_rad,
            roll_rate_rps=roll_rate_rps,
            pitch_rate_rps=pitch_rate_rps,
            climb_significant_mps=2.0 * float(np.sqrt(np.square(speeds_mps).mean())),
            tilt_significant_rad=2.0 * float(np.sqrt(np.square(tilts_rad).mean())),
            observed_s=float(times_ns[-1] - times_ns[0]) / NS_PER_S,
        )

    def _newest_tilt(self) -> tuple[float, float, float, float]:
        """Newest roll and pitch by the rover's IMU, and their rates; 0 while the rover sends none."""
        if len(self._tilts) < 2:
            return 0.0, 0.0, 0.0, 0.0
        t_ns, roll_rad, pitch_rad = self._tilts[-1]
        begin_ns, begin_roll_rad, begin_pitch_rad = next(
            tilt for tilt in self._tilts if t_ns - tilt[0] <= TILT_RATE_NS or tilt[0] == t_ns
        )
        passed_s = max(t_ns - begin_ns, 1) / NS_PER_S
        return roll_rad, pitch_rad, (roll_rad - begin_roll_rad) / passed_s, (pitch_rad - begin_pitch_rad) / passed_s

    def _note(self, t_ns: int) -> None:
        """Note a sign that the deck moves."""
        if not self.moves:
            self._motion.clear()
        self.moves = True
        self._moved_ns = max(self._moved_ns, t_ns)


def _append(samples: deque[tuple[int, float, float]], sample: tuple[int, float, float], span_ns: int) -> None:
    samples.append(sample)
    while sample[0] - samples[0][0] > span_ns:
        samples.popleft()
