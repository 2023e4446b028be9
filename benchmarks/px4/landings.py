"""Landings on the rover with PX4 and with the embedded autopilot, under the same conditions.

`JEZERO_PX4_DIR=<folder> python -m benchmarks.px4.landings [--rover drive] [--case uwb+tag] [--sea 0.5 5 5] [--n 5]
[--seed 0]`: the landings of `jezero bench landing`, once with PX4 as a process of its own, in lockstep with the
simulated world and no faster than real time, and once with the embedded autopilot. Prints each landing and a summary.
"""

import argparse
import json
import os
import sys
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from pathlib import Path

from benchmarks.px4.process import real_px4
from benchmarks.quality.autopilot import Make
from jezero.trials.landing.flight import Landing, fly_landing
from jezero.trials.landing.judge import percentile
from jezero.trials.landing.trial import CASES, MOTIONS, Conditions

EMBEDDED, PX4 = "embedded", "px4"


def pilot(name: str) -> AbstractContextManager[Make | None]:
    """Start an autopilot for one flight; None stands for the embedded one."""
    if name == EMBEDDED:
        return nullcontext()
    return real_px4(Path(os.environ["JEZERO_PX4_DIR"]), {}, always_paced=True)


def fly(name: str, conditions: Conditions, seeds: range) -> list[Landing]:
    """Fly the landings of one autopilot, and print each when it has ended."""
    landings = []
    for seed in seeds:
        with redirect_stdout(sys.stderr), pilot(name) as make:
            landings.append(fly_landing(seed, conditions, autopilot=make))
        landing = landings[-1]
        row = {
            "autopilot": name,
            "seed": seed,
            "error_m": None if landing.failure else round(landing.error_m, 4),
            "time_s": None if landing.failure else round(landing.time_s, 1),
            "impact_mps": landing.impact_mps,
            "failure": landing.failure,
        }
        print(json.dumps(row), flush=True)
    return landings


def main() -> None:
    """Print one line for each landing, then one for each autopilot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rover", choices=list(MOTIONS), default="still")
    parser.add_argument("--case", choices=CASES, default="uwb+tag")
    parser.add_argument("--sea", type=float, nargs=3, metavar=("HEIGHT", "PERIOD", "TILT"), help="m, s, degrees")
    parser.add_argument("--n", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sea = None if options.sea is None else tuple(options.sea)
    conditions = Conditions(case=options.case, rover=options.rover, sea=sea)
    seeds = range(options.seed, options.seed + options.n)
    flown = {name: fly(name, conditions, seeds) for name in (EMBEDDED, PX4)}
    for name, landings in flown.items():
        errors_m = [landing.error_m for landing in landings]
        figures = ", ".join(f"{100.0 * percentile(errors_m, fraction):.1f}" for fraction in (0.5, 0.95))
        time_s = percentile([landing.time_s for landing in landings], 0.5)
        landed = sum(not landing.failure for landing in landings)
        print(f"{name}: {landed} of {len(landings)} landed; touchdown median, p95: {figures} cm; median {time_s:.1f} s")


if __name__ == "__main__":
    main()
