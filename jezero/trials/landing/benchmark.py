"""Landings of many seeds on several processes, and their statistics."""

from collections.abc import Callable, Iterator
from functools import partial
from math import isfinite
from pathlib import Path

import msgspec

from jezero.trials.landing.flight import Landing, fly_landing
from jezero.trials.landing.judge import EstimateErrors, percentile
from jezero.trials.landing.trial import Conditions
from jezero.trials.workers import workers


class BenchmarkLanding(msgspec.Struct, frozen=True, kw_only=True):
    """One landing of a report.

    Attributes:
        seed: the trial's seed.
        landed: whether the vehicle stands on its target, disarmed.
        crashed: whether the landing ended in a crash, see `Landing.crashed`.
        go_arounds: number of go-arounds after a bad contact.
        reason: why the landing failed, or "".
    """

    seed: int
    landed: bool
    crashed: bool
    go_arounds: int
    reason: str


class LandingReport(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics of the landings of one benchmark.

    A failed landing counts as an infinite error and time. A statistic is None where it is infinite or without a sample.

    Attributes:
        case: sensors that the landings used.
        rover: the rover's motion.
        n: number of landings flown.
        landed: number of landings that did not fail.
        touchdown_error_m: "median", "p95" and "max" of the true horizontal distance from the target at disarm.
        time_s: "median" and "p95" of the time from the goal to disarm.
        rmse_m: 3D root mean square error of the relative position at ranges "below_3m" and "3_to_8m".
        nees: mean over estimates and dimensions of the normalised squared error; 1 is consistent.
        crashed: number of landings that ended in a crash, see `Landing.crashed`.
        gone_around: number of landings with at least one go-around after a bad contact.
        failed_seeds: seeds of the failed landings.
        touchdowns_m: (2,) true position at disarm of each landing that did not fail: forward and right of the
            platform's centre, or north and east of the spot in the case "none".
        outcomes: every landing.
    """

    case: str
    rover: str
    n: int
    landed: int
    crashed: int
    gone_around: int
    touchdown_error_m: dict[str, float | None]
    time_s: dict[str, float | None]
    rmse_m: dict[str, float | None]
    nees: float | None
    failed_seeds: list[int]
    touchdowns_m: list[tuple[float, float]]
    outcomes: list[BenchmarkLanding]


def fly_landings(
    conditions: Conditions,
    n: int,
    seed: int,
    jobs: int,
    on_landing: Callable[[Landing], None] = lambda landing: None,
    recordings: Path | None = None,
) -> LandingReport:
    """Fly `n` landings, with the seeds from `seed` on.

    Args:
        jobs: number of processes that fly in parallel.
        on_landing: called with each landing, in the order of the seeds.
        recordings: folder that gets each landing's recording as <case>-<seed>/flight.mcap.

    Raises:
        ConfigError: a configuration file is invalid.
    """
    landings: list[Landing] = []
    for landing in _landings(conditions, range(seed, seed + n), jobs, recordings):
        on_landing(landing)
        landings.append(landing)
    return _report(conditions, landings)


def _report(conditions: Conditions, landings: list[Landing]) -> LandingReport:
    errors = EstimateErrors()
    for landing in landings:
        errors.add(landing.errors)
    errors_m = [landing.error_m for landing in landings]
    times_s = [landing.time_s for landing in landings]
    return LandingReport(
        case=conditions.case,
        rover=conditions.rover,
        n=len(landings),
        landed=sum(not landing.failure for landing in landings),
        crashed=sum(landing.crashed for landing in landings),
        gone_around=sum(landing.go_arounds > 0 for landing in landings),
        touchdown_error_m={
            name: _finite(percentile(errors_m, share)) for name, share in (("median", 0.5), ("p95", 0.95), ("max", 1.0))
        },
        time_s={name: _finite(percentile(times_s, share)) for name, share in (("median", 0.5), ("p95", 0.95))},
        rmse_m={"below_3m": _finite(errors.rmse_m(0)), "3_to_8m": _finite(errors.rmse_m(1))},
        nees=_finite(errors.nees / errors.samples) if errors.samples else None,
        failed_seeds=[landing.seed for landing in landings if landing.failure],
        touchdowns_m=[
            (round(place_m[0], 4), round(place_m[1], 4))
            for place_m in (landing.error_rover_body_m for landing in landings)
            if place_m is not None
        ],
        outcomes=[
            BenchmarkLanding(
                seed=one.seed,
                landed=not one.failure,
                crashed=one.crashed,
                go_arounds=one.go_arounds,
                reason=one.failure,
            )
            for one in landings
        ],
    )


def _landings(conditions: Conditions, seeds: range, jobs: int, recordings: Path | None) -> Iterator[Landing]:
    fly = partial(fly_landing, conditions=conditions, recordings=recordings)
    if jobs == 1:
        yield from map(fly, seeds)
        return
    with workers(jobs) as pool:
        yield from pool.imap(fly, seeds)


def _finite(value: float | None) -> float | None:
    return round(value, 4) if value is not None and isfinite(value) else None
