"""Measure the delay from odometry to setpoint over a router's socket for services and over its TCP, in one run.

`python -m benchmarks.speed.socket_and_tcp`: two pairs of processes exchange messages of the same size through one
router with access control, one after the other: `bare.py` with nothing but Zenoh. Both pairs have the rights of
services here, which over TCP nobody has in a stack.
"""

import socket
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import zenoh
from msgspec.structs import replace

from benchmarks.speed.latency import delays
from benchmarks.speed.mavlink_proxy import HOST
from benchmarks.speed.stack import running_module
from jezero.base.zenoh_client import config_of
from jezero.deploy.launcher.ports import reserved_instance
from jezero.keys.rights import local_access_control
from jezero.runtime.instance import socket_of
from jezero.runtime.routing import ROUTER_SETTINGS

EXCHANGES = 2000
PERIOD_S = 0.01
TIMEOUT_S = 2.0


def main() -> None:
    """Measure both and print them."""
    with tempfile.TemporaryDirectory() as folder, reserved_instance() as instance, ExitStack() as ends:
        addresses = {"socket": socket_of(Path(folder)), "tcp": instance.router}
        rights = local_access_control()
        for policy in rights["policies"]:
            policy["rules"] = rights["policies"][0]["rules"]
        settings = {**ROUTER_SETTINGS, "listen/endpoints": list(addresses.values()), "access_control": rights}
        ends.enter_context(zenoh.open(config_of(settings)))
        links: dict[str, socket.socket] = {}
        for name, router in addresses.items():
            own = replace(instance, vehicle=name, router=router)
            links[name] = ends.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            links[name].settimeout(TIMEOUT_S)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind((HOST, 0))
                port = probe.getsockname()[1]
            for words in (("bridge", str(port)), ("action",)):
                process = ends.enter_context(running_module("benchmarks.speed.bare", *words, instance=own))
                assert process.stdout is not None
                process.stdout.readline()
            links[name].connect((HOST, port))
        taken_ms: dict[str, list[float]] = {name: [] for name in links}
        time.sleep(1.0)
        for _ in range(EXCHANGES):
            for name, link in links.items():
                link.send(b"odometry")
                taken_ms[name].append(int.from_bytes(link.recv(1024)[:8], "little") / 1e6)
                time.sleep(PERIOD_S)
    for name, ms in taken_ms.items():
        found = delays(ms)
        print(f"{name:6} {found.n} exchanges: median {found.median_ms:.2f} ms, p95 {found.p95_ms:.2f} ms")


if __name__ == "__main__":
    main()
