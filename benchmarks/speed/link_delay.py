"""Measure one-way delays of the real bus: from one service's step to another's, through the router.

`python -m benchmarks.speed.link_delay` prints the log-normal parameters that `jezero.runtime.memory_bus` uses.
"""

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterable
from math import log
from pathlib import Path

from benchmarks.speed.stack import running_module, running_router
from jezero.deploy.launcher.ports import reserved_instance
from jezero.runtime.instance import instance_from_environment
from jezero.runtime.process import new_boot_id, run_service
from jezero.runtime.service import Inbox, Output, Publish, Service, Spec
from jezero.schemas import topics
from jezero.schemas.state import Odometry

SECONDS = 20.0
RATE_HZ = 50.0


class Sender:
    """Publishes odometry stamped with the monotonic clock, which is common to all processes of a host."""

    spec = Spec(name="sender", outputs=(topics.ODOMETRY,), rate_hz=RATE_HZ)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(
            topics.ODOMETRY,
            Odometry(
                t_ns=time.monotonic_ns(),
                epoch_id=1,
                pos_uav_ned_m=(1.234567, -2.345678, -3.456789),
                vel_uav_ned_mps=(0.123456, 0.234567, 0.345678),
                q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
                rates_uav_frd_rps=(0.01, 0.02, 0.03),
            ),
        )


class Receiver:
    """Prints the delay of each message in ns."""

    spec = Spec(name="receiver", inputs=(topics.ODOMETRY,), triggers=(topics.ODOMETRY.name,), rate_hz=1)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        now_ns = time.monotonic_ns()
        for message in inbox.new(topics.ODOMETRY):
            print(now_ns - message.t_ns, flush=True)
        return ()


def main() -> None:
    """Run both ends and print the figures."""
    with (
        tempfile.TemporaryDirectory() as folder,
        reserved_instance(vehicle=f"delay{os.getpid()}") as reserved,
        running_router(reserved, Path(folder)) as (_, instance),
        running_module("benchmarks.speed.link_delay", "sender", instance=instance),
        running_module("benchmarks.speed.link_delay", "receiver", instance=instance) as receiver,
    ):
        time.sleep(SECONDS)
        receiver.terminate()
        assert receiver.stdout is not None
        delays_s = sorted(int(text) / 1e9 for text in receiver.stdout.read().split()[25:])
    median = statistics.median(delays_s)
    sigma = statistics.pstdev(log(d / median) for d in delays_s)
    print(
        f"{len(delays_s)} messages: median {median * 1e3:.2f} ms, sigma of ln {sigma:.2f}, "
        f"p99 {delays_s[int(0.99 * len(delays_s))] * 1e3:.2f} ms, max {delays_s[-1] * 1e3:.2f} ms"
    )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        service: Service = Sender() if sys.argv[1] == "sender" else Receiver()
        sys.exit(run_service(service, instance_from_environment(), new_boot_id()))
    main()
