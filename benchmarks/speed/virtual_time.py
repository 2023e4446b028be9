"""Processor time of a flight in virtual time, by service.

`python -m benchmarks.speed.virtual_time [--seed N]` flies what `jezero fly` flies on one core and prints, for each
service, how long its steps took (encoding and delivering what they yield included), and how much of all that was
MAVLink and Bullet; and how fast the flying core alone is, which lands on the same rover by the vehicle's own position.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Collection
from typing import Any

import msgspec

from jezero.base.config import load_config
from jezero.base.mavlink import MavlinkCodec
from jezero.runtime.node import Node
from jezero.schemas import topics
from jezero.schemas.goals import LandOnSpotGoal
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.flight import fly_virtually
from jezero.trials.missions import FLIGHT, Mission

VISION = ("camera", "tag_detector", "estimator")
"""Services that do not belong to the flying core."""


def core_flight() -> Mission:
    """`FLIGHT` with a landing on the rover's start position, which needs no estimate of the rover."""
    rover = load_config(SimulatorConfig, "simulator").rover
    spot_ned_m = (rover.start_north_m, rover.start_east_m, 0.0)
    land = LandOnSpotGoal(landing_spot_ned_m=spot_ned_m, use_uwb=False, use_tag=False)
    return (*FLIGHT[:-1], (topics.LAND_ON_SPOT, land, 0.0))


class Stopwatch:
    """Sums the processor time spent in functions, by label."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)

    def wrap(self, owner: Any, name: str, label: Callable[[Any], str]) -> None:
        """Time a method of a class; `label` names the row from the instance."""
        inner = getattr(owner, name)

        def timed(this: Any, *arguments: Any, **named: Any) -> Any:
            started = time.thread_time()
            try:
                return inner(this, *arguments, **named)
            finally:
                row = label(this)
                self.spent_s[row] += time.thread_time() - started
                self.calls[row] += 1

        setattr(owner, name, timed)


class Part(msgspec.Struct, frozen=True):
    """One row of the table.

    Attributes:
        calls: number of calls.
        us_per_step: processor time per 4 ms step.
        core_share: fraction of a core in real time.
    """

    calls: int
    us_per_step: float
    core_share: float


class Flight(msgspec.Struct, frozen=True):
    """One flight.

    Attributes:
        sim_time_s: virtual time of the flight.
        real_time_factor: virtual time per wall time, without stopwatches.
        core_factor: virtual time per processor time, which hardly depends on other processes.
        flying_core_factor: `core_factor` of the flying core alone.
        parts: parts by name, the longest first.
    """

    sim_time_s: float
    real_time_factor: float
    core_factor: float
    flying_core_factor: float
    parts: dict[str, Part]


def _timed(mission: Mission, seed: int, without: Collection[str] = ()) -> tuple[float, float]:
    """Fly, and return virtual time per wall time and per processor time.

    Raises:
        RuntimeError: the flight failed.
    """
    wall_s, core_s = time.perf_counter(), time.process_time()
    flight = fly_virtually(mission, seed, without=without)
    wall_s, core_s = time.perf_counter() - wall_s, time.process_time() - core_s
    if flight.result != "succeeded":
        raise RuntimeError(flight.reason)
    return flight.real_time_factor, flight.real_time_factor * wall_s / core_s


def measure(seed: int) -> Flight:
    """Fly plainly for the factors, then with stopwatches for the parts, which stay in this process."""
    from jezero.services.simulator.world import World

    real_time_factor, core_factor = _timed(FLIGHT, seed)
    _, flying_core_factor = _timed(core_flight(), seed, VISION)
    watch = Stopwatch()
    watch.wrap(Node, "step", lambda node: str(node.spec.name))
    watch.wrap(MavlinkCodec, "parse", lambda _codec: "of which MAVLink parsing")
    watch.wrap(MavlinkCodec, "pack", lambda _codec: "of which MAVLink packing")
    watch.wrap(MavlinkCodec, "pack_numbers", lambda _codec: "of which MAVLink packing")
    watch.wrap(World, "step", lambda _world: "of which Bullet and its axes")
    flight = fly_virtually(FLIGHT, seed)
    steps = flight.sim_time_s * 250.0
    rows = sorted(watch.spent_s.items(), key=lambda item: ("of which" in item[0], -item[1]))
    return Flight(
        sim_time_s=flight.sim_time_s,
        real_time_factor=real_time_factor,
        core_factor=core_factor,
        flying_core_factor=flying_core_factor,
        parts={
            row: Part(watch.calls[row], spent_s / steps * 1e6, spent_s / flight.sim_time_s) for row, spent_s in rows
        },
    )


def main() -> None:
    """Fly and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    flight = measure(parser.parse_args().seed)
    print(f"{flight.sim_time_s:.1f} s flown at {flight.real_time_factor:.1f}x real time")
    print(f"{flight.core_factor:.1f}x per second of processor time")
    print(f"{flight.flying_core_factor:.1f}x the flying core alone, landing by the vehicle's own position")
    print(f"{'part':<30}{'calls':>8}{'us per 4 ms':>13}{'% of a core in real time':>26}")
    for name, part in flight.parts.items():
        print(f"{name:<30}{part.calls:>8}{part.us_per_step:>13.1f}{part.core_share * 100:>25.1f} %")


if __name__ == "__main__":
    main()
