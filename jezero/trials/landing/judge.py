"""Judges one landing by the truth, which nothing that flies may see. Source: spec §8."""

from math import hypot, inf, sqrt

import msgspec
import numpy as np

from jezero.frames import Vec3, add, scale, subtract
from jezero.schemas import topics
from jezero.schemas.estimate import Relative
from jezero.schemas.state import Status, Truth
from jezero.trials.platform import offset_m

IMPACT_MAX_MPS = 0.6
NEAR_M, FAR_M = 3.0, 8.0
SAMPLES = 6
"""Dimensions of the relative state: position and velocity."""


class Errors(msgspec.Struct):
    """Sums over the valid estimates of a landing.

    Attributes:
        count, square_m2: of the relative position's error, below 3 m and from 3 to 8 m.
        nees: sum of the normalised squared errors of position and velocity, divided by their number, so that a
            consistent estimate has 1 per sample.
    """

    count: list[int] = msgspec.field(default_factory=lambda: [0, 0])
    square_m2: list[float] = msgspec.field(default_factory=lambda: [0.0, 0.0])
    nees: float = 0.0
    samples: int = 0

    def add(self, other: "Errors") -> None:
        """Take in another landing's."""
        for i in range(2):
            self.count[i] += other.count[i]
            self.square_m2[i] += other.square_m2[i]
        self.nees += other.nees
        self.samples += other.samples

    def rmse_m(self, band: int) -> float | None:
        """Root of the mean square below 3 m (0) or from there to 8 m (1); None without a sample."""
        return sqrt(self.square_m2[band] / self.count[band]) if self.count[band] else None


class LandingJudge:
    """Watches a bus from the goal to the end.

    Attributes:
        truth, status: the newest.
        errors: of the estimate, so far.
        impact_mps: greatest speed towards the platform or ground at which the vehicle met it.
        disarmed_ns: when, after `begin`.
    """

    def __init__(self) -> None:
        self.truth: Truth | None = None
        self.status: Status | None = None
        self.errors = Errors()
        self.impact_mps = 0.0
        self.disarmed_ns: int | None = None
        self._begun_ns: int | None = None
        self._touched = False
        self._before: Truth | None = None
        self._waiting: list[Relative] = []
        self._decoders = {
            topic.name: msgspec.json.Decoder(topic.type) for topic in (topics.TRUTH, topics.STATUS, topics.RELATIVE)
        }

    def begin(self, t_ns: int) -> None:
        """From now on it counts."""
        self._begun_ns = t_ns

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        """One message of the bus."""
        decoder = self._decoders.get(topic)
        if decoder is None or (topic == topics.RELATIVE.name and self._begun_ns is None):
            return
        message = decoder.decode(data)
        if isinstance(message, Truth):
            self._take_truth(message)
        elif isinstance(message, Relative):
            self._waiting.append(message)
        else:
            self.status = message
            if self._begun_ns is not None and not message.armed and self.disarmed_ns is None:
                self.disarmed_ns = t_ns

    def _take_truth(self, truth: Truth) -> None:
        before, self.truth = self.truth, truth
        if before is None or self._begun_ns is None:
            return
        if truth.contact_force_n > 0.0 and before.contact_force_n == 0.0:
            self._touched = True
            towards_mps = before.vel_uav_ned_mps[2] - before.vel_rover_ned_mps[2]
            self.impact_mps = max(self.impact_mps, towards_mps)
        waiting, self._waiting = self._waiting, []
        for relative in waiting:
            if relative.t_ns > truth.t_ns:
                self._waiting.append(relative)
            elif relative.valid and relative.goal_id and relative.t_ns >= before.t_ns and not self._touched:
                self._compare(relative, before, truth)

    def _compare(self, relative: Relative, before: Truth, after: Truth) -> None:
        share = (relative.t_ns - before.t_ns) / (after.t_ns - before.t_ns)
        pos_ned_m = _between(offset_m(before), offset_m(after), share)
        vel_ned_mps = _between(_offset_mps(before), _offset_mps(after), share)
        error_m = subtract(relative.pos_uav_rel_rover_ned_m, pos_ned_m)
        error_mps = subtract(relative.vel_uav_rel_rover_ned_mps, vel_ned_mps)
        error = np.array([*error_m, *error_mps])
        covariance = np.zeros((SAMPLES, SAMPLES))
        covariance[np.triu_indices(SAMPLES)] = relative.cov
        covariance += np.triu(covariance, 1).T
        errors = self.errors
        errors.nees += float(error @ np.linalg.solve(covariance, error)) / SAMPLES
        errors.samples += 1
        range_m = hypot(*pos_ned_m)
        if range_m < FAR_M:
            band = 0 if range_m < NEAR_M else 1
            errors.count[band] += 1
            errors.square_m2[band] += sum(e * e for e in error_m)


def percentile(values: list[float], share: float) -> float:
    """The smallest value that at least this share of all does not exceed; infinite ones are values like others."""
    ordered = sorted(values)
    rank = max(0, min(len(ordered) - 1, -int(-share * len(ordered) // 1) - 1))
    return ordered[rank] if ordered else inf


def _offset_mps(truth: Truth) -> Vec3:
    return subtract(truth.vel_uav_ned_mps, truth.vel_rover_ned_mps)


def _between(a: Vec3, b: Vec3, share: float) -> Vec3:
    return add(scale(a, 1.0 - share), scale(b, share))
