"""Speed of the fault campaign with the point mass, and the processor time of its parts.

`python -m benchmarks.speed.point_mass [--seeds N]` flies the first N missions on one core, first plainly for the
factor, then with stopwatches for the parts (with judging, encoding and delivery of a step's outputs).
"""

import argparse
import time

from benchmarks.speed.virtual_time import Stopwatch
from jezero.base.mavlink import MavlinkCodec
from jezero.runtime.node import Node
from jezero.trials.campaign.mission import fly_mission


def main() -> None:
    """Fly and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(parser.parse_args().seeds)
    fly_mission(0, model="point-mass")  # fill caches, import modules
    wall_s, core_s = time.perf_counter(), time.process_time()
    sim_time_s = sum(fly_mission(seed, model="point-mass").sim_time_s for seed in seeds)
    wall_s, core_s = time.perf_counter() - wall_s, time.process_time() - core_s
    watch = Stopwatch()
    watch.wrap(Node, "step", lambda node: str(node.spec.name))
    watch.wrap(MavlinkCodec, "parse", lambda _codec: "of which MAVLink parsing")
    watch.wrap(MavlinkCodec, "pack", lambda _codec: "of which MAVLink packing")
    watch.wrap(MavlinkCodec, "pack_numbers", lambda _codec: "of which MAVLink packing")
    for seed in seeds:
        fly_mission(seed, model="point-mass")
    print(f"{len(seeds)} missions, {sim_time_s:.0f} s flown at {sim_time_s / wall_s:.0f}x real time")
    print(f"{sim_time_s / core_s:.0f}x per second of processor time")
    print(f"{'part':<30}{'steps per s':>12}{'ms per s':>10}")
    for name, spent_s in sorted(watch.spent_s.items(), key=lambda item: ("of which" in item[0], -item[1])):
        print(f"{name:<30}{watch.calls[name] / sim_time_s:>12.0f}{1e3 * spent_s / sim_time_s:>10.2f}")


if __name__ == "__main__":
    main()
