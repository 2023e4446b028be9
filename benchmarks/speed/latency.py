"""Delays in a flying stack, each against exchanges through the same router at the same time: bare, and by hand."""

import os
import signal
import socket
import subprocess
import time
from bisect import bisect_right
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Literal

import msgspec
import zenoh
from msgspec.structs import replace

from benchmarks.speed import bare, by_hand
from benchmarks.speed.mavlink_proxy import Times
from benchmarks.speed.stack import compose_file, percentile, running_module, running_stack, wait_for
from jezero import Canceled, Vehicle
from jezero.base.zenoh_client import client_config
from jezero.deploy.launcher.ports import HOST, reserved_instance
from jezero.runtime.instance import Instance, socket_of
from jezero.schemas.state import StatusCode

ODOMETRY_TO_SETPOINT = "odometry received -> setpoint sent"
FLY_S = 1.0
"""Duration of each goal's flight before it is canceled."""
SIDE_M = 3.0
LEFT_OUT_SERVICES = ("camera", "estimator", "tag_detector")
"""Services that are left out: they use odometry too, or load the machine, unlike the ends of the bare exchange."""
HEIGHT_M = 3.0
Replies = tuple[float, float]
"""Times from a goal to its acceptance and to its first feedback, in ms."""
GoalsMs = tuple[list[Replies], list[Replies], list[Replies]]
"""Replies of jezero, of the bare exchange and of the exchange by hand."""


class Delays(msgspec.Struct, frozen=True):
    """Delays of one kind of exchange, in ms."""

    n: int
    median_ms: float
    p95_ms: float


class Row(msgspec.Struct, frozen=True):
    """One row of the table.

    Attributes:
        own: the exchange with jezero.
        bare: the same exchange with nothing but Zenoh.
        by_hand: the same exchange with pymavlink, json and Zenoh alone.
        left_out: number of exchanges whose two ends could not be paired.
    """

    own: Delays
    bare: Delays
    by_hand: Delays
    left_out: int = 0

    @property
    def ratio(self) -> float:
        return self.own.median_ms / self.bare.median_ms

    @property
    def ratio_by_hand(self) -> float:
        return self.own.median_ms / self.by_hand.median_ms


def delays(taken_ms: list[float]) -> Delays:
    """Number, median and 95th percentile of times."""
    return Delays(n=len(taken_ms), median_ms=percentile(taken_ms, 0.5), p95_ms=percentile(taken_ms, 0.95))


def row(own_ms: list[float], bare_ms: list[float], by_hand_ms: list[float], left_out: int = 0) -> Row:
    """Row of the times of one exchange in the three ways."""
    return Row(delays(own_ms), delays(bare_ms), delays(by_hand_ms), left_out)


class Latency(msgspec.Struct, frozen=True):
    """Delays of all exchanges.

    Attributes:
        exchanges: rows by name.
        tick_ms: median time from one odometry to the next. No exchange contains it, because an arrival triggers each of
            their steps.
        bare_zenoh_ms: median time of the bare exchange of odometry and setpoint without UDP.
    """

    exchanges: dict[str, Row]
    tick_ms: float
    bare_zenoh_ms: float


def measure(folder: Path, goals: int) -> Latency:
    """Fly `goals` goals that are canceled on the way; a relay in front of the vehicle bridge measures times."""
    with reserved_instance(vehicle=f"bench{os.getpid()}") as instance, ExitStack() as stack:
        bridge_port, own_port, bare_port, by_hand_port = ports = _free_udp_ports(4)
        relay = stack.enter_context(running_module("benchmarks.speed.mavlink_proxy", *ports, instance=instance))
        bridge = f"python -m benchmarks.speed.shifted_bridge {bridge_port} {own_port}"
        path = compose_file(folder, without=LEFT_OUT_SERVICES, commands={"vehicle_bridge": bridge})
        stack.enter_context(running_stack(instance, folder / "run", "-f", str(path)))
        at_socket = replace(instance, router=socket_of(folder / "run"))
        for words in (
            ("bare", "bridge", bare_port),
            ("bare", "action"),
            ("by_hand", "bridge", by_hand_port),
            ("by_hand", "action"),
        ):
            module = f"benchmarks.speed.{words[0]}"
            end = stack.enter_context(running_module(module, *words[1:], instance=at_socket))
            if end.stdout is None or end.stdout.readline() != "ready\n":
                raise RuntimeError(f"{module} {words[1]} did not start")
        session = stack.enter_context(zenoh.open(client_config(at_socket.router)))
        with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
            uav.wait_ready()
            goals_ms, flights_ns = _fly(uav, session, instance, goals)
        passed = _stop_and_read(relay)
    hops_ms, left_out = pair(passed.odometry_ns, passed.setpoint_ns, flights_ns)
    ticks_ms = [(b - a) / 1e6 for a, b in pairwise(passed.odometry_ns)]
    found = {
        ODOMETRY_TO_SETPOINT: row(hops_ms, _ms(passed.bare_ns), _ms(passed.by_hand_ns), left_out),
        "goal -> accepted": row(*_each(goals_ms, 0)),
        "goal -> first feedback": row(*_each(goals_ms, 1)),
    }
    return Latency(found, percentile(ticks_ms, 0.5), percentile(_ms(passed.bare_zenoh_ns), 0.5))


def _ms(taken_ns: list[int]) -> list[float]:
    return [ns / 1e6 for ns in taken_ns]


def _each(goals_ms: GoalsMs, reply: Literal[0, 1]) -> tuple[list[float], list[float], list[float]]:
    """Times until one of the two replies, in the three ways."""
    own, zenoh_alone, unchecked = ([taken_ms[reply] for taken_ms in goal_ms] for goal_ms in goals_ms)
    return own, zenoh_alone, unchecked


def _fly(uav: Vehicle, session: zenoh.Session, instance: Instance, goals: int) -> tuple[GoalsMs, list[tuple[int, int]]]:
    """Fly the goals; returns times of replies, and (begin, end) of each flight in ns of the realtime clock."""
    own: list[Replies] = []
    others: tuple[list[Replies], list[Replies]] = ([], [])
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
        for request_goal, taken_ms in zip((bare.request_goal, by_hand.request_goal), others, strict=True):
            time.sleep(0.037)
            accepted_s, feedback_s = request_goal(session, instance)
            taken_ms.append((accepted_s * 1e3, feedback_s * 1e3))
    return (own, *others), flights_ns


def pair(odometry_ns: list[int], setpoint_ns: list[int], flights_ns: list[tuple[int, int]]) -> tuple[list[float], int]:
    """Match setpoints to the odometry that they were computed from.

    Args:
        flights_ns: (begin, end) of each flight.

    Returns:
        Delays in ms where exactly one setpoint came before the next odometry, and the number of other odometries.
    """
    paired: list[float] = []
    left_out = 0
    for begin_ns, end_ns in flights_ns:
        inside = [t for t in odometry_ns if begin_ns < t < end_ns]
        for first_ns, next_ns in pairwise(inside):
            setpoints_ns = setpoint_ns[bisect_right(setpoint_ns, first_ns) : bisect_right(setpoint_ns, next_ns)]
            if len(setpoints_ns) == 1:
                paired.append((setpoints_ns[0] - first_ns) / 1e6)
            else:
                left_out += 1
    return paired, left_out


def _free_udp_ports(n: int) -> list[str]:
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(n)]
        for probe in probes:
            probe.bind((HOST, 0))
        return [str(probe.getsockname()[1]) for probe in probes]


def _stop_and_read(relay: "subprocess.Popen[str]") -> Times:
    relay.send_signal(signal.SIGTERM)
    output, _ = relay.communicate(timeout=30)
    return msgspec.json.decode(output.splitlines()[-1], type=Times)
