"""Accuracy and consistency of the estimator: errors against its own covariance, over fixed seeds."""

from collections import defaultdict
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.quality.estimator import CASES, Sample, judge, replay, rmse_m
from benchmarks.quality.estimator_flight import EstimatorFlight
from jezero.base.arrays import Array
from jezero.services.estimator.kalman import Kalman
from jezero.services.estimator.measurement_history import MeasurementHistory
from jezero.services.estimator.measurements import Kind

SEEDS = range(4)
CONFIDENCE = 0.999
pytestmark = pytest.mark.timeout(900)
Flights = list[list[Sample]]


@lru_cache
def flown(case: str) -> tuple[Flights, dict[Kind, tuple[float, int]]]:
    """Samples of each flight by time, and the sum of NIS with its degrees of freedom by kind of measurement."""
    setup = CASES[case]
    nis: dict[Kind, list[tuple[float, int]]] = defaultdict(list)
    flights = []
    with pytest.MonkeyPatch.context() as patch:
        fuse, update = MeasurementHistory._fuse, Kalman.update
        of_updates: list[float] = []

        def watched_update(self: Kalman, innovation: Array, H: Array, R: Array) -> None:
            of_updates.append(float(innovation @ np.linalg.solve(self.innovation_covariance(H, R), innovation)))
            update(self, innovation, H, R)

        def watched(self: MeasurementHistory, measurement: object) -> None:
            of_updates.clear()
            fuse(self, measurement)  # type: ignore[arg-type]
            entry = self.entries[-1]
            nis[entry.measurement.kind].append((of_updates[0] if of_updates else 0.0, entry.result.used))

        patch.setattr(Kalman, "update", watched_update)
        patch.setattr(MeasurementHistory, "_fuse", watched)
        for seed in SEEDS:
            flight = EstimatorFlight(seed, setup.conditions)
            flights.append(list(judge(flight, replay(flight, setup.use_uwb, setup.use_tag))))
    sums = {kind: (sum(n for n, _ in rows), sum(used for _, used in rows)) for kind, rows in nis.items()}
    return flights, sums


@pytest.mark.parametrize(
    ("case", "below_3m_m", "from_3_to_8m_m"),
    [("uwb+tag", 0.02, 0.09), ("uwb+tag, 20 % blocked, tag hidden", 0.03, 0.135)],
)
def test_the_relative_position_is_accurate(case: str, below_3m_m: float, from_3_to_8m_m: float) -> None:
    samples = [sample for flight in flown(case)[0] for sample in flight]
    assert all(sample.valid for sample in samples)
    assert rmse_m(samples, 0.0, 3.0) < below_3m_m
    assert rmse_m(samples, 3.0, 8.0) < from_3_to_8m_m


def test_the_errors_are_as_large_as_the_covariance_says() -> None:
    """At every instant the mean over the flights is below chi-square's bound, and over all instants within both.

    The velocity errors are smaller than the covariance, which includes the full error of the autopilot's velocity.
    """
    flights, _ = flown("uwb+tag")
    shortest = min(map(len, flights))
    for name, dof in (("nees_position", 3), ("nees", 6)):
        nees = np.array([[getattr(flight[i], name) for i in range(0, shortest, 5)] for flight in flights])
        lower, upper = chi2.ppf((1.0 - CONFIDENCE, CONFIDENCE), dof * len(SEEDS)) / len(SEEDS)
        assert float(nees.mean(axis=0).max()) < upper
        assert float(nees.mean()) < 1.2 * dof
        if name == "nees_position":
            assert float(nees.mean()) > lower


@pytest.mark.parametrize("kind", ["altimeter", "uwb", "tag"])
def test_innovations_are_within_what_the_filter_expects(kind: Kind) -> None:
    """Far below is by intent: the noises contain errors that stay, which innovations don't show."""
    total, dof = flown("uwb+tag")[1][kind]
    assert dof > 1000
    assert 0.1 * dof < total < chi2.ppf(CONFIDENCE, dof)
