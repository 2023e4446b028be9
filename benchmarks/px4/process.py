"""PX4 as a service of the memory bus: a process of its own, in lockstep with the simulated world."""

import select
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from benchmarks.quality.autopilot import READY_S, Make
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.deploy.launcher.ports import HOST, reserved_instance
from jezero.runtime.instance import Instance
from jezero.runtime.links import TcpServer, Udp
from jezero.runtime.service import Inbox, Output, Send, Service, Spec
from jezero.services.autopilot import px4
from jezero.services.autopilot.px4_link import ChildLink
from jezero.services.vehicle_bridge.parameters import ParameterSetter, Value

HIL, OFFBOARD = "hil", "offboard"
FIRST_REPLY_TIMEOUT_S = 0.02
REPLY_TIMEOUT_S = 0.5
"""Longer than any delay on a busy machine. PX4 does not reply to its first few sensor readings."""
START_TIMEOUT_S = 10.0


class Px4Process:
    """PX4 behind the links of a service on the memory bus.

    PX4 replies to each HIL_SENSOR before virtual time continues. Until it is ready, virtual time runs no faster than
    wall time, because its start-up script uses wall time.

    Args:
        parameters: parameters to set at the first telemetry; the bridge sets its own.
        always_paced: virtual time never runs faster than wall time. Nothing waits for PX4's telemetry, and the faster
            virtual time runs, the later telemetry arrives.
    """

    spec = Spec(name="autopilot", links=(HIL, OFFBOARD), triggers=(HIL, OFFBOARD), rate_hz=250.0)

    def __init__(self, runtime: Path, instance: Instance, parameters: Mapping[str, Value], always_paced: bool) -> None:
        self._system_id = instance.system_id
        self._hil = TcpServer(HOST, instance.hil_port)
        self._offboard = Udp((HOST, instance.bridge_port), (HOST, instance.autopilot_offboard_port))
        command = px4.command(runtime, instance.number)
        self._child = ChildLink("PX4", command, px4.environment(VehicleConfig().battery), None, instance.hil_port)
        for link in (self._hil, self._offboard, self._child):
            link.start()
        self._begin_s = time.monotonic()
        while not self._hil.up:
            if time.monotonic() - self._begin_s > START_TIMEOUT_S:
                raise TimeoutError("PX4 has not connected")
            self._child.poll(time.monotonic_ns())
            self._hil.poll(time.monotonic_ns())
            time.sleep(0.001)
        self._always_paced = always_paced
        self._wall_behind_s = -time.monotonic()
        self._reply_timeout_s = FIRST_REPLY_TIMEOUT_S
        self._setter = ParameterSetter(parameters)
        self._codec = MavlinkCodec(instance.system_id, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Pass on all bytes that arrived, in both directions."""
        self._child.poll(time.monotonic_ns())
        if setpoints := inbox.received(OFFBOARD):
            self._offboard.send(setpoints)
        if readings := inbox.received(HIL):
            self._hil.send(readings)
            select.select(self._hil.sockets(), [], [], self._reply_timeout_s)
            if commands := self._hil.poll(time.monotonic_ns()):
                self._reply_timeout_s = REPLY_TIMEOUT_S
                yield Send(HIL, commands)
        if telemetry := self._offboard.poll(time.monotonic_ns()):
            self._set_parameters(t_ns, telemetry)
            yield Send(OFFBOARD, telemetry)
        if self._always_paced or t_ns < READY_S * 1e9:
            self._pace(t_ns * 1e-9)

    def _pace(self, t_s: float) -> None:
        """Wait until wall time has caught up. Time lost to other programs is not recovered."""
        wall_s = self._wall_behind_s + time.monotonic()
        if t_s > wall_s:
            time.sleep(t_s - wall_s)
        else:
            self._wall_behind_s += t_s - wall_s

    def _set_parameters(self, t_ns: int, telemetry: bytes) -> None:
        """Set the parameters, as the bridge does at the first telemetry."""
        if not self._setter.pending:
            return
        for message in self._codec.parse(telemetry):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
                self._setter.confirm(message.param_id, message.param_value, message.param_type)
        for name, value, kind in self._setter.due(t_ns):
            message = dialect.MAVLink_param_set_message(self._system_id, 1, name.encode(), value, kind)
            self._offboard.send(self._codec.pack(message))
        if self._setter.failed:
            raise RuntimeError(self._setter.failure_text)

    def close(self) -> None:
        """End PX4."""
        for link in (self._child, self._hil, self._offboard):
            link.close()


@contextmanager
def real_px4(runtime: Path, parameters: Mapping[str, Value], *, always_paced: bool = False) -> Iterator[Make]:
    """PX4 for one flight, with the given parameters in place of its own."""
    with reserved_instance() as instance:
        started: list[Px4Process] = []

        def make() -> tuple[Service, int]:
            started.append(Px4Process(runtime, instance, parameters, always_paced))
            return started[-1], instance.system_id

        try:
            yield make
        finally:
            for process in started:
                process.close()
