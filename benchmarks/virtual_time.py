"""Where the time of a flight in virtual time goes.

`python -m benchmarks.virtual_time [--seed N]` flies the demonstration on one core and prints, for each service, how
long its steps took (encoding and delivering what they yield included), and how much of all that was MAVLink and Bullet.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from jezero.cli.mission import LANDING_SPOT_NED_M, MISSION
from jezero.deploy.virtual_flight import fly_virtually
from jezero.mavlink import MavlinkCodec
from jezero.runtime.node import Node


class Stopwatch:
    """Sums the time spent in functions, by label."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)

    def wrap(self, owner: Any, name: str, label: Callable[[Any], str]) -> None:
        """Time a method of a class; `label` names the row from the instance."""
        inner = getattr(owner, name)

        def timed(this: Any, *arguments: Any) -> Any:
            started = time.perf_counter()
            try:
                return inner(this, *arguments)
            finally:
                row = label(this)
                self.spent_s[row] += time.perf_counter() - started
                self.calls[row] += 1

        setattr(owner, name, timed)


def main() -> None:
    """Fly and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed
    plain = fly_virtually(MISSION, LANDING_SPOT_NED_M, seed)
    watch = Stopwatch()
    watch.wrap(Node, "step", lambda node: str(node.spec.name))
    watch.wrap(MavlinkCodec, "parse", lambda _codec: "of which MAVLink parsing")
    watch.wrap(MavlinkCodec, "pack", lambda _codec: "of which MAVLink packing")
    from jezero.services.simulator.world import World

    watch.wrap(World, "step", lambda _world: "of which Bullet and its axes")
    flight = fly_virtually(MISSION, LANDING_SPOT_NED_M, seed)
    steps = flight.sim_time_s * 250.0
    print(f"{flight.sim_time_s:.1f} s flown at {plain.real_time_factor:.1f}x real time")
    print(f"{'part':<30}{'calls':>8}{'us per 4 ms':>13}{'% of a core in real time':>26}")
    for row, spent_s in sorted(watch.spent_s.items(), key=lambda item: ("of which" in item[0], -item[1])):
        print(
            f"{row:<30}{watch.calls[row]:>8}{spent_s / steps * 1e6:>13.1f}{spent_s / flight.sim_time_s * 100:>25.1f} %"
        )


if __name__ == "__main__":
    main()
