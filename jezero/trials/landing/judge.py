"""Measurement of one landing against the simulator's truth, which the flying services never read."""

from math import hypot, inf, sqrt

import msgspec
import numpy as np

from jezero.base.frames import Vec3, add, scale, subtract
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import LandPhase
from jezero.schemas.state import Status, Truth
from jezero.trials.platform import is_on_its_back, offset_m

IMPACT_MAX_MPS = 0.6
CRASH_IMPACT_MPS = 1.0
NEAR_RANGE_M, FAR_RANGE_M = 3.0, 8.0
DIMENSIONS = 6
"""Position and velocity of the relative state."""


class EstimateErrors(msgspec.Struct):
    """Sums over the valid estimates of a landing.

    Attributes:
        count: (2,) number of estimates at ranges below 3 m, and from 3 to 8 m.
        square_m2: (2,) sums of the squared errors of the relative position in the same two bands of range.
        nees: sum of the normalised squared errors of position and velocity, divided by the number of dimensions, so
            that a consistent estimate contributes 1 per sample on average.
        samples: number of estimates in `nees`.
    """

    count: list[int] = msgspec.field(default_factory=lambda: [0, 0])
    square_m2: list[float] = msgspec.field(default_factory=lambda: [0.0, 0.0])
    nees: float = 0.0
    samples: int = 0

    def add(self, other: "EstimateErrors") -> None:
        """Add another landing's sums."""
        for i in range(2):
            self.count[i] += other.count[i]
            self.square_m2[i] += other.square_m2[i]
        self.nees += other.nees
        self.samples += other.samples

    def rmse_m(self, band: int) -> float | None:
        """Root mean square position error below 3 m (band 0) or from 3 to 8 m (band 1); None without a sample."""
        return sqrt(self.square_m2[band] / self.count[band]) if self.count[band] else None


class LandingJudge:
    """Observer of a bus that measures a landing from its goal to disarm.

    Attributes:
        truth: the latest truth.
        status: the latest status.
        errors: errors of the relative estimate so far.
        impact_mps: highest speed towards the platform or ground at which the vehicle touched it.
        disarmed_ns: time of the first disarmed status after `start`; None before.
        go_arounds: number of go-arounds after a bad contact.
    """

    def __init__(self) -> None:
        self.truth: Truth | None = None
        self.status: Status | None = None
        self.errors = EstimateErrors()
        self.impact_mps = 0.0
        self.disarmed_ns: int | None = None
        self.go_arounds = 0
        self._phase: LandPhase = "approach"
        self._start_ns: int | None = None
        self._touched_down = False
        self._previous: Truth | None = None
        self._pending: list[Relative] = []
        self._decoders = {
            topic.name: msgspec.json.Decoder(topic.type)
            for topic in (topics.TRUTH, topics.STATUS, topics.RELATIVE, topics.feedback_of(topics.LAND_ON_SPOT))
        }

    @property
    def crashed(self) -> bool:
        """Whether the vehicle lies on its side, hit something hard, or runs its motors while it touches something."""
        truth = self.truth
        running = truth is not None and truth.armed_motors and truth.contact_force_n > 0.0
        fallen = truth is not None and is_on_its_back(truth)
        return fallen or running or self.impact_mps > CRASH_IMPACT_MPS

    def start(self, t_ns: int) -> None:
        """Start to measure, at the time of the landing's goal."""
        self._start_ns = t_ns

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        """Process one message of the bus."""
        decoder = self._decoders.get(topic)
        if decoder is None or (topic == topics.RELATIVE.name and self._start_ns is None):
            return
        message = decoder.decode(data)
        if isinstance(message, Truth):
            self._on_truth(message)
        elif isinstance(message, Relative):
            self._pending.append(message)
        elif isinstance(message, FeedbackMessage):
            self.go_arounds += message.feedback.phase == "go_around" != self._phase
            self._phase = message.feedback.phase
        else:
            self._on_status(t_ns, message)

    def _on_status(self, t_ns: int, status: Status) -> None:
        self.status = status
        if self._start_ns is not None and not status.armed and self.disarmed_ns is None:
            self.disarmed_ns = t_ns

    def _on_truth(self, truth: Truth) -> None:
        previous, self.truth = self.truth, truth
        if previous is None or self._start_ns is None:
            return
        if truth.contact_force_n > 0.0 and previous.contact_force_n == 0.0:
            self._touched_down = True
            towards_mps = previous.vel_uav_ned_mps[2] - previous.vel_rover_ned_mps[2]
            self.impact_mps = max(self.impact_mps, towards_mps)
        pending, self._pending = self._pending, []
        for relative in pending:
            if relative.t_ns > truth.t_ns:
                self._pending.append(relative)
            elif relative.valid and relative.goal_id and relative.t_ns >= previous.t_ns and not self._touched_down:
                self._compare(relative, previous, truth)

    def _compare(self, relative: Relative, previous: Truth, after: Truth) -> None:
        share = (relative.t_ns - previous.t_ns) / (after.t_ns - previous.t_ns)
        pos_ned_m = _interpolate(offset_m(previous), offset_m(after), share)
        vel_ned_mps = _interpolate(_offset_mps(previous), _offset_mps(after), share)
        error_m = subtract(relative.pos_uav_rel_rover_ned_m, pos_ned_m)
        error_mps = subtract(relative.vel_uav_rel_rover_ned_mps, vel_ned_mps)
        error = np.array([*error_m, *error_mps])
        covariance = np.zeros((DIMENSIONS, DIMENSIONS))
        covariance[np.triu_indices(DIMENSIONS)] = relative.cov
        covariance += np.triu(covariance, 1).T
        errors = self.errors
        errors.nees += float(error @ np.linalg.solve(covariance, error)) / DIMENSIONS
        errors.samples += 1
        range_m = hypot(*pos_ned_m)
        if range_m < FAR_RANGE_M:
            band = 0 if range_m < NEAR_RANGE_M else 1
            errors.count[band] += 1
            errors.square_m2[band] += sum(e * e for e in error_m)


def percentile(values: list[float], share: float) -> float:
    """Smallest value that is not exceeded by at least this share of all values, infinite ones included."""
    ordered = sorted(values)
    rank = max(0, min(len(ordered) - 1, -int(-share * len(ordered) // 1) - 1))
    return ordered[rank] if ordered else inf


def _offset_mps(truth: Truth) -> Vec3:
    return subtract(truth.vel_uav_ned_mps, truth.vel_rover_ned_mps)


def _interpolate(a: Vec3, b: Vec3, share: float) -> Vec3:
    return add(scale(a, 1.0 - share), scale(b, share))
