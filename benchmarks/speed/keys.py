"""Measure what keys cost: delays over the routers of two computers, and their processor time, beside bare Zenoh.

`python -m benchmarks.speed.keys` links two routers in three ways, one after the other: bare routers of Zenoh over TCP,
jezero's without keys, and jezero's with keys (TLS on both sides, rights, and the log of what is denied).
"""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import zenoh

from benchmarks.speed.stack import percentile
from jezero.base.zenoh_client import client_config
from jezero.keys.team import Team
from jezero.runtime.instance import socket_of
from jezero.schemas.topics import HOVER, STATUS, key

VEHICLE = "keys"
SECONDS = 15.0
MESSAGES_HZ, REQUESTS_HZ = 200.0, 20.0
MESSAGE_BYTES = 1000
CONNECT_TIMEOUT_S = 10.0
SETTLE_S = 1.0
BARE = """
import json, sys, time, zenoh
config = zenoh.Config()
for name, value in json.loads(sys.argv[1]).items():
    config.insert_json5(name, json.dumps(value))
with zenoh.open(config):
    time.sleep(3600)
"""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures of one way to link the routers.

    Attributes:
        delays_s: delay of each message from the vehicle's computer to the ground's.
        round_trips_s: time of each request from the ground to the vehicle, with its reply.
        cpu_s: processor time of both routers, for all of that.
    """

    delays_s: list[float]
    round_trips_s: list[float]
    cpu_s: float

    def __str__(self) -> str:
        delays_ms = [1e3 * percentile(self.delays_s, share) for share in (0.5, 0.99)]
        trips_ms = [1e3 * percentile(self.round_trips_s, share) for share in (0.5, 0.99)]
        each_us = 1e6 * self.cpu_s / (len(self.delays_s) + len(self.round_trips_s))
        return (
            f"message {delays_ms[0]:.2f} ms (p99 {delays_ms[1]:.2f}), request {trips_ms[0]:.2f} ms "
            f"(p99 {trips_ms[1]:.2f}), {each_us:.0f} us of both routers a message"
        )


def free_port() -> int:
    """A port on which nobody listens now."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def bare_router(listen: list[str], connect: list[str]) -> list[str]:
    """Command of a router of Zenoh with its own defaults."""
    settings = f'{{"mode": "router", "listen/endpoints": {listen}, "connect/endpoints": {connect}}}'.replace("'", '"')
    return [sys.executable, "-c", BARE, settings]


@contextmanager
def running(command: list[str], variables: Mapping[str, str]) -> Iterator[int]:
    """A router's process; its id."""
    process = subprocess.Popen(command, env={**os.environ, **variables}, stderr=subprocess.DEVNULL)
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()


def measure(folder: Path, kind: str) -> Figures:
    """Measure one way to link the routers: `bare`, `without keys` or `with keys`."""
    vehicle, ground = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    link = f"{'tls' if kind == 'with keys' else 'tcp'}/127.0.0.1:{free_port()}"
    if kind == "bare":
        commands = [bare_router([vehicle, link], []), bare_router([ground], [link])]
        variables: list[dict[str, str]] = [{}, {}]
    else:
        commands, variables = [], []
        for own, way, bundle in (
            (vehicle, {"JEZERO_LISTEN": link}, "vehicle-uav1"),
            (ground, {"JEZERO_CONNECT": link}, "ground-lab"),
        ):
            run = {"JEZERO_VEHICLE": VEHICLE, "JEZERO_RUN_DIR": str(folder / bundle)}
            keys = {"JEZERO_KEYS": str(folder / bundle), "JEZERO_INSECURE": "1"}
            commands += [[sys.executable, "-m", f"jezero.runtime.{each}"] for each in ("router", "gate")]
            variables += [
                {**run, "JEZERO_ROUTER": own},
                {**run, **keys, **way, "JEZERO_ROUTER": socket_of(folder / bundle)},
            ]
        vehicle, ground = (socket_of(folder / bundle) for bundle in ("vehicle-uav1", "ground-lab"))
    with ExitStack() as ends:
        routers = [ends.enter_context(running(*each)) for each in zip(commands, variables, strict=True)]
        sessions = [zenoh.open(client_config(each, CONNECT_TIMEOUT_S)) for each in (vehicle, ground)]
        one, other = map(ends.enter_context, sessions)
        return _exchange(one, other, routers)


def _exchange(vehicle: zenoh.Session, ground: zenoh.Session, routers: list[int]) -> Figures:
    delays_s: list[float] = []
    trips_s: list[float] = []

    def on_message(sample: zenoh.Sample) -> None:
        delays_s.append((time.monotonic_ns() - int(bytes(sample.payload)[:20])) * 1e-9)

    def on_request(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, b"{}")

    status, hover = key(VEHICLE, STATUS.name), key(VEHICLE, HOVER.name)
    ground.declare_subscriber(status, on_message)
    vehicle.declare_queryable(hover, on_request, complete=True)
    publisher = vehicle.declare_publisher(status)
    while not delays_s:  # the routers are not linked yet
        publisher.put(f"{time.monotonic_ns():020}".ljust(MESSAGE_BYTES))
        time.sleep(0.05)
    time.sleep(SETTLE_S)
    delays_s.clear()
    begin_cpu_s, begin_s = sum(map(_cpu_s, routers)), time.monotonic()
    for number in range(int(SECONDS * MESSAGES_HZ)):
        time.sleep(max(0.0, begin_s + number / MESSAGES_HZ - time.monotonic()))
        publisher.put(f"{time.monotonic_ns():020}".ljust(MESSAGE_BYTES))
        if number % int(MESSAGES_HZ / REQUESTS_HZ) == 0:
            asked_s = time.monotonic()
            if any(reply.ok for reply in ground.get(hover, timeout=2.0)):
                trips_s.append(time.monotonic() - asked_s)
    time.sleep(SETTLE_S)
    return Figures(delays_s=delays_s, round_trips_s=trips_s, cpu_s=sum(map(_cpu_s, routers)) - begin_cpu_s)


def _cpu_s(process: int) -> float:
    """Processor time that a process has used so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure all three and print them."""
    with tempfile.TemporaryDirectory() as name:
        team = Team(Path(name))
        team.found()
        team.add("vehicle", "uav1")
        team.add("ground", "lab")
        for kind in ("bare", "without keys", "with keys"):
            print(f"{kind:13} {measure(team.folder, kind)}", flush=True)


if __name__ == "__main__":
    main()
