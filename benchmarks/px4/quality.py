"""PX4 and the embedded autopilot side by side, in the same world, wind and sensor errors, with the same setpoints.

`JEZERO_PX4_DIR=<folder> python -m benchmarks.px4.quality [--seeds N]`: 3 m/s mean wind, gusts of 0.6 m/s. PX4 flies as
a process of its own, in lockstep with the simulated world and faster than real time, with the parameters that the
bridge gives it, once without the gains among them. All other parts are the same.
"""

import argparse
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from math import degrees, inf
from pathlib import Path
from statistics import median

import msgspec

from benchmarks.px4.process import real_px4
from benchmarks.quality.autopilot import CLIMB_S, HEIGHT_M, READY_S, Flight, Make, Target, embedded, fly, hold, track
from jezero.base.config import load_config
from jezero.base.frames import tilt_from_quat
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig

DESCENT_START_S = READY_S + CLIMB_S
DESCENT_MPS = 0.5
GAINS = ("MPC_XY_VEL_P_ACC", "MPC_XY_VEL_I_ACC")
"""Parameters of the bridge that change the flight control."""


class Landing(msgspec.Struct, frozen=True):
    """Figures of one landing; infinite when the autopilot did not land and disarm.

    Attributes:
        impact_mps: downward velocity just before the first contact.
        tilt_max_deg: largest tilt after the first contact.
        off_s: time from the first contact until the autopilot has disarmed.
        whole_s: time from the command, or the loss, until the autopilot has disarmed.
    """

    impact_mps: float
    tilt_max_deg: float
    off_s: float
    whole_s: float


def _landing(flight: Flight, from_s: float) -> Landing:
    """Evaluate the truth of a landing. On the ground, armed motors idle and disarmed motors stand still."""
    descent = [t for t in flight.truth if t.t_ns > from_s * 1e9]
    touched = next((i for i, t in enumerate(descent) if t.contact_force_n > 0.0), None)
    off_s = max((t.t_ns * 1e-9 for t in descent if t.armed_motors), default=inf)
    if touched is None or descent[-1].armed_motors:
        return Landing(inf, inf, inf, inf)
    return Landing(
        descent[touched - 1].vel_uav_ned_mps[2],
        max(degrees(tilt_from_quat(t.q_ned_from_frd)) for t in descent[touched:]),
        off_s - descent[touched].t_ns * 1e-9,
        off_s - from_s,
    )


def land(seed: int, autopilot: Make) -> Landing:
    """Descend at 0.5 m/s by velocity setpoints until the autopilot switches its motors off by itself."""

    def target(t_s: float) -> Target:
        return ((0.0, 0.0, -HEIGHT_M), None) if t_s < DESCENT_START_S else (None, (0.0, 0.0, DESCENT_MPS))

    return _landing(
        fly(target, seed, DESCENT_START_S + HEIGHT_M / DESCENT_MPS + 10.0, autopilot=autopilot), DESCENT_START_S
    )


def lose_offboard(seed: int, autopilot: Make) -> Landing:
    """Stop the stream of setpoints at 5 m."""

    def target(t_s: float) -> Target:
        return ((0.0, 0.0, -HEIGHT_M) if t_s < DESCENT_START_S else None), None

    return _landing(fly(target, seed, DESCENT_START_S + 25.0, autopilot=autopilot), DESCENT_START_S)


Figures = dict[str, float]


def figures(seed: int, autopilot: Callable[[], AbstractContextManager[Make]]) -> Figures:
    """Figures of one autopilot and seed, by name with unit."""
    with autopilot() as make:
        held = hold(seed, autopilot=make)
    with autopilot() as make:
        tracked = track(seed, autopilot=make)
    with autopilot() as make:
        landed = land(seed, make)
    with autopilot() as make:
        lost = lose_offboard(seed, make)
    return {
        "hold, p95 over 60 s (m)": held.p95_m,
        "hold, vertical RMS (m)": held.rms_vertical_m,
        "estimate off the truth, at most (m)": held.wander_max_m,
        "velocity tracking, RMS (m/s)": tracked.rms_mps,
        "2 m/s step, 90 % rise (s)": tracked.rise_s,
        "2 m/s step, overshoot (%)": 100.0 * tracked.overshoot,
        "landing at 0.5 m/s: impact (m/s)": landed.impact_mps,
        "landing: tilt after contact, at most (deg)": landed.tilt_max_deg,
        "landing: contact to disarmed (s)": landed.off_s,
        "offboard lost 5 m up: impact (m/s)": lost.impact_mps,
        "offboard lost: tilt after contact, at most (deg)": lost.tilt_max_deg,
        "offboard lost: until landed and disarmed (s)": lost.whole_s,
    }


def main() -> None:
    """Print a table with the median and the largest value of all seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    runtime = Path(os.environ["JEZERO_PX4_DIR"])
    flown = []
    parameters = load_config(VehicleBridgeConfig, "vehicle_bridge").parameters
    without_gains = {name: value for name, value in parameters.items() if name not in GAINS}
    with redirect_stdout(sys.stderr):
        for autopilot in (
            lambda: real_px4(runtime, without_gains),
            lambda: real_px4(runtime, parameters),
            lambda: nullcontext(embedded),
        ):
            flown.append([figures(seed, autopilot) for seed in seeds])
    print(f"| median (largest) of {len(seeds)} seeds | PX4, its own gains | PX4 | embedded |\n|---|---|---|---|")
    for name in flown[0][0]:
        cells = ([flight[name] for flight in flights] for flights in flown)
        print(f"| {name} | {' | '.join(f'{median(values):.2f} ({max(values):.2f})' for values in cells)} |")


if __name__ == "__main__":
    main()
