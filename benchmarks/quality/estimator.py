"""Accuracy, consistency and processor time of the estimator.

`python -m benchmarks.quality.estimator [--flights N] [--case NAME]` flies approaches without physics
(`estimator_flight`) past the shipped estimator. Printed per case: RMSE in 3D by range, normalised estimation error
squared (3 would be exact for the position, 6 for position and velocity), share of the time in which it is valid, and
time of the step.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from benchmarks.quality.estimator_flight import Conditions, EstimatorFlight
from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.frames import norm
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Output, Publish
from jezero.schemas import topics
from jezero.schemas.estimate import Relative
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.service import Estimator

COST_RUNS = 5
SETTLED_S = 3.0
"""Time of hover before the evaluation begins."""
HIDDEN_S = ((3.0, 4.0), (6.0, 7.0))
AS_SHIPPED = Conditions()


@dataclass(frozen=True, kw_only=True)
class Case:
    """Conditions of the flights, and the inputs that the estimator may use."""

    conditions: Conditions = AS_SHIPPED
    use_uwb: bool = True
    use_tag: bool = True


CASES: dict[str, Case] = {
    "uwb+tag": Case(),
    "uwb+tag, uwb 10 cm": Case(conditions=Conditions(uwb_std_m=0.1)),
    "uwb+tag, 20 % blocked, tag hidden": Case(conditions=Conditions(uwb_blocked=0.2, hidden_s=HIDDEN_S)),
    "uwb+tag, drive": Case(conditions=Conditions(speed_mps=0.5)),
    "uwb+tag, turn": Case(conditions=Conditions(speed_mps=1.0, yaw_rate_rps=0.2)),
    "uwb": Case(use_tag=False),
    "uwb 10 cm, 10 % blocked": Case(conditions=Conditions(uwb_std_m=0.1, uwb_blocked=0.1), use_tag=False),
    "tag": Case(use_uwb=False),
    "tag, latency 300 ms": Case(conditions=Conditions(latency_s=0.3), use_uwb=False),
}


@dataclass(frozen=True)
class Sample:
    """One result of the estimator against the truth; errors (6,) of position and velocity, covariance (6, 6)."""

    range_m: float
    valid: bool
    error: Array
    cov: Array

    @property
    def nees_position(self) -> float:
        e = self.error[:3]
        return float(e @ np.linalg.solve(self.cov[:3, :3], e))

    @property
    def nees(self) -> float:
        return float(self.error @ np.linalg.solve(self.cov, self.error))


def replay(
    flight: EstimatorFlight, use_uwb: bool, use_tag: bool, seconds: list[float] | None = None
) -> Iterator[Relative]:
    """The shipped estimator's results for a flight.

    Args:
        seconds: gets the CPU time of each step with odometry.
    """
    shipped = load_config(EstimatorConfig, "estimator")
    tuning = msgspec.structs.replace(shipped.tuning, use_uwb=use_uwb, use_tag=use_tag)
    estimator = Estimator(msgspec.structs.replace(shipped, tuning=tuning), load_config(VehicleConfig, "vehicle"))
    inbox = Mailbox(())
    for t_ns, topic, message in flight.arrivals():
        inbox.add_message(topic.name, message)
        if topic is not topics.ODOMETRY:
            continue
        begun_s = time.process_time()
        outputs: Sequence[Output] = list(estimator.step(t_ns, inbox))
        if seconds is not None:
            seconds.append(time.process_time() - begun_s)
        inbox.clear()
        for output in outputs:
            if isinstance(output, Publish) and isinstance(output.message, Relative):
                yield output.message


def judge(flight: EstimatorFlight, results: Iterator[Relative]) -> Iterator[Sample]:
    """Compare each result after `SETTLED_S` with the truth of its time."""
    for result in results:
        if not SETTLED_S <= result.t_ns / NS_PER_S <= flight.end_s:
            continue
        truth = flight.truth(result.t_ns / NS_PER_S)
        estimated = result.pos_uav_rel_rover_ned_m + result.vel_uav_rel_rover_ned_mps
        cov = np.zeros((6, 6))
        cov[np.triu_indices(6)] = result.cov
        cov += np.triu(cov, 1).T
        error = np.array(estimated) - np.array(truth.pos_rel_m + truth.vel_rel_mps)
        yield Sample(norm(truth.pos_rel_m), result.valid, error, cov)


def rmse_m(samples: Sequence[Sample], nearest_m: float, farthest_m: float) -> float:
    """RMSE of the 3D position of all valid results within a span of ranges; NaN when there are none."""
    squares = [s.error[:3] @ s.error[:3] for s in samples if s.valid and nearest_m <= s.range_m < farthest_m]
    return float(np.sqrt(np.mean(squares))) if squares else float("nan")


def step_costs_ms(case: Case) -> Array:
    """CPU time of each step of one flight, the least of some runs, in which other programs disturb least."""
    flight = EstimatorFlight(0, case.conditions)
    runs: list[list[float]] = []
    for _ in range(COST_RUNS):
        seconds: list[float] = []
        for _result in replay(flight, case.use_uwb, case.use_tag, seconds):
            pass
        runs.append(seconds)
    least: Array = 1e3 * np.array(runs).min(axis=0)
    return least


def fly(case: Case, flights: int) -> dict[str, float]:
    """Fly and evaluate a case."""
    samples: list[Sample] = []
    for seed in range(flights):
        flight = EstimatorFlight(seed, case.conditions)
        samples += judge(flight, replay(flight, case.use_uwb, case.use_tag))
    valid = [sample for sample in samples if sample.valid]
    ms = step_costs_ms(case)
    return {
        "rmse_below_3m_m": rmse_m(samples, 0.0, 3.0),
        "rmse_3_to_8m_m": rmse_m(samples, 3.0, 8.0),
        "nees_position": float(np.mean([s.nees_position for s in valid])),
        "nees": float(np.mean([s.nees for s in valid])),
        "valid": len(valid) / len(samples),
        "step_median_ms": float(np.median(ms)),
        "step_p99_ms": float(np.percentile(ms, 99)),
        "core": float(np.mean(ms)) * 50.0 / 1e3,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20, help="per case (default 20)")
    parser.add_argument("--case", choices=CASES, action="append", help="only this; may be repeated")
    parser.add_argument("--json", action="store_true", help="one object per line")
    options = parser.parse_args()
    if not options.json:
        print(f"{'':34}  < 3 m   3-8 m   NEES/3  NEES/6  valid   step median   p99   core")
    for name in options.case or CASES:
        r = fly(CASES[name], options.flights)
        if options.json:
            print(json.dumps({"case": name, **r}), flush=True)
            continue
        print(
            f"{name:34} {100 * r['rmse_below_3m_m']:5.1f} cm {100 * r['rmse_3_to_8m_m']:5.1f} cm "
            f"{r['nees_position']:6.2f} {r['nees']:7.2f} {100 * r['valid']:6.1f} % "
            f"{r['step_median_ms']:7.2f} ms {r['step_p99_ms']:6.2f} ms {100 * r['core']:5.1f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
