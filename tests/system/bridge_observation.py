"""Observation of the bridge from outside: its statuses, and its messages to the autopilot."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import yaml

from benchmarks.speed.mavlink_proxy import Passed, Relay
from jezero import Vehicle
from jezero.base.config import config_directory
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.instance import Instance
from jezero.schemas.state import Status, StatusCode

HOST = "127.0.0.1"
REQUESTS = {dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAV_CMD_REQUEST_MESSAGE}
"""Commands that have no effect on the vehicle."""
STATUS_DELAY_MAX_NS = 100_000_000
"""Longest time between a change of the status and its record."""


class Tap:
    """A relay between autopilot and bridge.

    Attributes:
        words: arguments of `jezero up` that put the relay between them.
    """

    def __init__(self, instance: Instance, folder: Path) -> None:
        bridge_port, own_port, unused_port = _free_udp_ports(3)
        compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
        command = f"python -m benchmarks.speed.shifted_bridge {bridge_port} {own_port}"
        compose["services"]["vehicle_bridge"]["command"] = command
        (folder / "tapped.yaml").write_text(yaml.safe_dump(compose))
        self.words = ("-f", str(folder / "tapped.yaml"))
        self._relay = Relay(instance, bridge_port, own_port, unused_port, unused_port)
        self._end, self._stop = socket.socketpair()
        self._thread = threading.Thread(target=self._relay.run, args=(self._stop,), daemon=True)
        self._thread.start()

    def close(self) -> list[Passed]:
        """Stop the relay; returns all datagrams of the bridge, with times in ns of the realtime clock."""
        self._end.close()
        self._thread.join()
        self._stop.close()
        return self._relay.from_bridge


def _free_udp_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for probe in probes:
            probe.bind((HOST, 0))
        return [probe.getsockname()[1] for probe in probes]


@contextmanager
def recorded_statuses(vehicle: Vehicle) -> Iterator[list[tuple[int, Status]]]:
    """List that grows by (time in ns of the realtime clock, status) twenty times a second."""
    statuses: list[tuple[int, Status]] = []
    stop = threading.Event()

    def record() -> None:
        while not stop.wait(0.05):
            status = vehicle.status()
            statuses.append((time.time_ns(), status))

    recorder = threading.Thread(target=record, daemon=True)
    recorder.start()
    try:
        yield statuses
    finally:
        stop.set()
        recorder.join()


def assert_bridge_silent(statuses: list[tuple[int, Status]], sent: list[Passed], modes: list[str]) -> None:
    """Assert status 13 from arming to disarming, and that the bridge sends nothing but heartbeats meanwhile.

    On the ground, before and after, the bridge may request telemetry; it sends no other command and no setpoint.

    Args:
        modes: modes of the autopilot in status 13, in their order, without hold.
    """
    armed = [status for _, status in statuses if status.armed]
    external = [(t_ns, status) for t_ns, status in statuses if status.code == StatusCode.EXTERNAL]
    assert len(external) >= len(armed) - 2 > 0  # the bridge may know of arming just before its status changes
    assert {s.in_charge for _, s in external} == {"external"}
    assert [m for m in dict.fromkeys(s.autopilot_mode for _, s in external) if m != "AUTO.LOITER"] == modes
    assert not any(s.grant or s.goal_id for _, s in external)
    begin_ns, end_ns = external[0][0], external[-1][0] - STATUS_DELAY_MAX_NS
    codec = MavlinkCodec(255, 0)
    messages = [(t_ns, message) for t_ns, data in sent for message in codec.parse(data) if t_ns > statuses[0][0]]
    during = [m.get_msgId() for t_ns, m in messages if begin_ns <= t_ns <= end_ns]
    assert set(during) == {dialect.MAVLINK_MSG_ID_HEARTBEAT}
    assert len(during) <= (end_ns - begin_ns) * 1e-9 + 2
    others = [m for _, m in messages if m.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT]
    assert {getattr(m, "command", 0) for m in others} <= REQUESTS
