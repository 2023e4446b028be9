"""Measure what a member that floods the gate costs the programs of the vehicle's own computer.

`python -m benchmarks.speed.flood`: two services exchange messages at one router, 50 times a second, while a viewer
floods the gate of this router; and, for comparison, while the same viewer floods the gate of another computer, which
takes the same processors. Each kind of flood lasts for 20 s.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import zenoh

from benchmarks.speed.flooder import FLOODS
from benchmarks.speed.keys import free_port
from benchmarks.speed.stack import percentile
from jezero.base.zenoh_client import client_config
from jezero.keys.bundle import secured
from jezero.keys.team import Team
from jezero.runtime.instance import socket_of

VEHICLE = "uav1"
SECONDS = 20.0
PERIOD_S = 0.02
CONNECT_TIMEOUT_S = 30.0


@contextmanager
def computer(team: Team, folder: Path) -> Iterator[tuple[str, str]]:
    """A router and its gate; the addresses of the router for services and of the gate."""
    gate, people = f"tls/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    bundle = team.bundle("vehicle-uav1")
    variables = {**os.environ, "JEZERO_RUN_DIR": str(folder), "JEZERO_LISTEN": gate, "JEZERO_KEYS": str(bundle)}
    routers = {"router": people, "gate": socket_of(folder)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", f"jezero.runtime.{name}"],
            env={**variables, "JEZERO_ROUTER": router},
            stderr=subprocess.DEVNULL,
        )
        for name, router in routers.items()
    ]
    try:
        yield socket_of(folder), gate
    finally:
        for process in processes:
            process.terminate()
            process.wait(10.0)


def delays_ms(bus: str, seconds: float) -> list[float]:
    """Delay of each message from one service to another."""
    found: list[float] = []
    with ExitStack() as ends:
        one, other = (ends.enter_context(zenoh.open(client_config(bus, CONNECT_TIMEOUT_S))) for _ in range(2))

        def on_sample(sample: zenoh.Sample) -> None:
            found.append((time.monotonic_ns() - int(sample.payload.to_bytes())) / 1e6)

        other.declare_subscriber("jezero/uav1/odometry", zenoh.handlers.Callback(on_sample, indirect=False))
        publisher = one.declare_publisher("jezero/uav1/odometry")
        begin_s = time.monotonic()
        for number in range(int(seconds / PERIOD_S)):
            time.sleep(max(0.0, begin_s + number * PERIOD_S - time.monotonic()))
            publisher.put(str(time.monotonic_ns()))
        time.sleep(0.5)
    return found


def flooded_ms(kind: str, bus: str, gate: str, viewer: Path) -> tuple[list[float], int]:
    """Delays of a bus during a flood of a gate, and the number of messages that were sent."""
    words = [kind, VEHICLE, secured(gate, viewer), str(SECONDS)]
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.speed.flooder", *words], stdout=subprocess.PIPE, text=True
    ) as flooder:
        found = delays_ms(bus, SECONDS)
        sent, _ = flooder.communicate()
    return found, int(sent)


def main() -> None:
    """Measure all floods and print them."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as ends:
        team = Team(Path(name) / "team")
        team.found()
        team.add("vehicle", "uav1")
        team.add("viewer", "eye")
        viewer = team.bundle("viewer-eye")
        bus, gate = ends.enter_context(computer(team, Path(name) / "own"))
        _, elsewhere = ends.enter_context(computer(team, Path(name) / "other"))
        print(f"quiet: {_in_words(delays_ms(bus, SECONDS))}", flush=True)
        for kind in FLOODS:
            p99_ms = []
            for where, address in (("another computer's gate", elsewhere), ("the own gate", gate)):
                found, sent = flooded_ms(kind, bus, address, viewer)
                p99_ms.append(percentile(found, 0.99))
                print(f"{kind:8} at {where}, {sent} sent: {_in_words(found)}", flush=True)
            print(f"{kind:8} p99 is {p99_ms[1] / p99_ms[0]:.1f} times that of the other flood", flush=True)


def _in_words(found_ms: list[float]) -> str:
    figures = (percentile(found_ms, 0.5), percentile(found_ms, 0.99), max(found_ms))
    return "median {:.2f} ms, p99 {:.2f} ms, longest {:.1f} ms".format(*figures)


if __name__ == "__main__":
    main()
