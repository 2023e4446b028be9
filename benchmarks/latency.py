"""Delays in a flying stack, each against a bare Zenoh exchange through the same router at the same time."""

import json
import os
import signal
import socket
import subprocess
import time
from bisect import bisect_right
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from benchmarks import bare
from benchmarks.stack import ROOT, percentile, running_module, running_stack, wait_for
from jezero import Canceled, Vehicle
from jezero.deploy.launcher.ports import HOST, reserved_instance
from jezero.runtime.config import Instance
from jezero.runtime.zenoh_session import client_config
from jezero.schemas.state import StatusCode

FLY_S = 1.0
"""How long each goal flies before it is canceled."""
SIDE_M = 3.0
HEIGHT_M = 3.0


class Delays(msgspec.Struct, frozen=True):
    """One row of the table, in ms.

    Attributes:
        bare_median_ms, bare_p95_ms: of the same exchange with nothing but Zenoh in it.
        left_out: exchanges whose two ends could not be paired.
    """

    n: int
    median_ms: float
    p95_ms: float
    bare_n: int
    bare_median_ms: float
    bare_p95_ms: float
    left_out: int = 0

    @property
    def ratio(self) -> float:
        return self.median_ms / self.bare_median_ms


def delays(own_ms: list[float], bare_ms: list[float], left_out: int = 0) -> Delays:
    """Medians and 95th percentiles of both."""
    return Delays(
        n=len(own_ms),
        median_ms=percentile(own_ms, 0.5),
        p95_ms=percentile(own_ms, 0.95),
        bare_n=len(bare_ms),
        bare_median_ms=percentile(bare_ms, 0.5),
        bare_p95_ms=percentile(bare_ms, 0.95),
        left_out=left_out,
    )


def measure(folder: Path, goals: int) -> tuple[dict[str, Delays], float]:
    """Fly `goals` goals that are canceled on the way, the vehicle bridge behind a relay that takes the times.

    Returns:
        A row of each exchange, and the median time in ms from one odometry to the next, which none of them contains:
        every step in them is triggered by what arrives.
    """
    with reserved_instance(vehicle=f"bench{os.getpid()}") as instance, ExitStack() as stack:
        bridge_port, bare_port = _free_udp_port(), _free_udp_port()
        relay = stack.enter_context(running_module("benchmarks.mavlink_proxy", str(bridge_port), instance=instance))
        stack.enter_context(running_stack(instance, folder / "run", "-f", str(_compose_file(folder, bridge_port))))
        for role in (("bridge", str(bare_port)), ("action",)):
            end = stack.enter_context(running_module("benchmarks.bare", *role, instance=instance))
            assert end.stdout is not None
            end.stdout.readline()
        caller = stack.enter_context(running_module("benchmarks.bare", "caller", str(bare_port), instance=instance))
        session = stack.enter_context(zenoh.open(client_config(instance.router)))
        with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
            uav.wait_ready()
            own, plain, flights_ns = _fly(uav, session, instance, goals)
        passed, pinged = _stop_and_read(relay), _stop_and_read(caller)
    hops_ms, left_out = pair(passed["odometry_ns"], passed["setpoint_ns"], flights_ns)
    pings_ms = [ns / 1e6 for ns in pinged["all_ns"][50:]]
    zenoh_ms = [ns / 1e6 for ns in pinged["zenoh_ns"][50:]]
    ticks_ms = [(b - a) / 1e6 for a, b in pairwise(passed["odometry_ns"])]
    found = {
        "odometry received -> setpoint sent": delays(hops_ms, pings_ms, left_out),
        "the same against Zenoh's part alone, without UDP": delays(hops_ms, zenoh_ms, left_out),
        "goal -> accepted": delays([a for a, _ in own], [a for a, _ in plain]),
        "goal -> first feedback": delays([f for _, f in own], [f for _, f in plain]),
    }
    return found, percentile(ticks_ms, 0.5)


def _fly(
    uav: Vehicle, session: zenoh.Session, instance: Instance, goals: int
) -> tuple[list[tuple[float, float]], list[tuple[float, float]], list[tuple[int, int]]]:
    """Own and bare (accepted, first feedback) in ms, and when a goal flew, in ns of the realtime clock."""
    own: list[tuple[float, float]] = []
    plain: list[tuple[float, float]] = []
    flights_ns: list[tuple[int, int]] = []
    uav.takeoff(altitude_m=HEIGHT_M).result(timeout_s=60)
    for number in range(goals):
        begin_s = time.perf_counter()
        goal = uav.go_to(SIDE_M * (-1) ** number, 0.0, -HEIGHT_M)
        accepted_s = time.perf_counter() - begin_s
        next(goal.feedback())
        own.append((accepted_s * 1e3, (time.perf_counter() - begin_s) * 1e3))
        flight_begin_ns = time.time_ns()
        time.sleep(FLY_S)
        flights_ns.append((flight_begin_ns, time.time_ns()))
        goal.cancel()
        try:
            goal.result(timeout_s=10)
        except Canceled:
            wait_for(lambda: uav.status().code == StatusCode.HOVER, 10, "hover after a goal")
        time.sleep(0.037)
        accepted_s, feedback_s = bare.ask_goal(session, instance)
        plain.append((accepted_s * 1e3, feedback_s * 1e3))
    return own, plain, flights_ns


def pair(odometry_ns: list[int], setpoint_ns: list[int], flights_ns: list[tuple[int, int]]) -> tuple[list[float], int]:
    """Match setpoints to the odometry that they were computed from.

    Args:
        flights_ns: beginnings and ends of the times in which a goal flew.

    Returns:
        Delays in ms where exactly one setpoint came before the next odometry, and the number of other odometries.
    """
    paired: list[float] = []
    left_out = 0
    for begin_ns, end_ns in flights_ns:
        inside = [t for t in odometry_ns if begin_ns < t < end_ns]
        for first_ns, next_ns in pairwise(inside):
            answers = setpoint_ns[bisect_right(setpoint_ns, first_ns) : bisect_right(setpoint_ns, next_ns)]
            if len(answers) == 1:
                paired.append((answers[0] - first_ns) / 1e6)
            else:
                left_out += 1
    return paired, left_out


def _compose_file(folder: Path, bridge_port: int) -> Path:
    """The shipped one, with the vehicle bridge on another port."""
    text = (ROOT / "deploy" / "compose.yaml").read_text(encoding="utf-8")
    usual = "python -m jezero.services.vehicle_bridge"
    if text.count(usual) != 1:
        raise RuntimeError("the compose file starts the vehicle bridge in another way than this benchmark knows")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "compose.yaml"
    path.write_text(text.replace(usual, f"python -m benchmarks.shifted_bridge {bridge_port}"), encoding="utf-8")
    return path


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _stop_and_read(process: "subprocess.Popen[str]") -> Any:
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=30)
    return json.loads(output.splitlines()[-1])
