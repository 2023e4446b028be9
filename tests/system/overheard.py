"""What others see of a flight: every status of the bridge, and every message that it sends to the autopilot."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import yaml

from benchmarks.speed.mavlink_proxy import Passed, Relay
from jezero import Vehicle
from jezero.mavlink import MavlinkCodec, dialect
from jezero.runtime.config import Instance, config_directory
from jezero.schemas.state import Status, StatusCode

HOST = "127.0.0.1"
SETTLE_NS = 100_000_000
"""A status may have changed so long before a watcher knows."""


class Tap:
    """A relay between the autopilot and the bridge of a stack that is started with `words`."""

    def __init__(self, instance: Instance, folder: Path) -> None:
        bridge_port, own_port, nobodys_port = _free_udp_ports(3)
        compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
        command = f"python -m benchmarks.speed.shifted_bridge {bridge_port} {own_port}"
        compose["services"]["vehicle_bridge"]["command"] = command
        (folder / "tapped.yaml").write_text(yaml.safe_dump(compose))
        self.words = ("-f", str(folder / "tapped.yaml"))
        self._relay = Relay(instance, bridge_port, own_port, nobodys_port, nobodys_port)
        self._end, self._stop = socket.socketpair()
        self._thread = threading.Thread(target=self._relay.run, args=(self._stop,), daemon=True)
        self._thread.start()

    def close(self) -> list[Passed]:
        """Stop relaying; all datagrams that the bridge sent, and when, in ns of the realtime clock."""
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
def watching(vehicle: Vehicle) -> Iterator[list[tuple[int, Status]]]:
    """Look at the status twenty times a second; filled with (time in ns of the realtime clock, status)."""
    seen: list[tuple[int, Status]] = []
    stop = threading.Event()

    def watch() -> None:
        while not stop.wait(0.05):
            status = vehicle.status()
            seen.append((time.time_ns(), status))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield seen
    finally:
        stop.set()
        watcher.join()


def assert_that_the_bridge_only_watched(seen: list[tuple[int, Status]], sent: list[Passed], modes: list[str]) -> None:
    """Status 13 from arming to disarming, through these modes; nothing but heartbeats on its link all the while.

    On the ground, before and after, it may ask for telemetry; it never commands, sets or streams anything.
    """
    armed = [status for _, status in seen if status.armed]
    watched = [(t_ns, status) for t_ns, status in seen if status.code == StatusCode.EXTERNAL]
    assert len(watched) >= len(armed) - 2 > 0  # armed may be known an instant before the status changes
    assert {s.in_charge for _, s in watched} == {"external"}
    assert [m for m in dict.fromkeys(s.autopilot_mode for _, s in watched) if m != "AUTO.LOITER"] == modes
    assert not any(s.control_id or s.goal_id for _, s in watched)
    begin_ns, end_ns = watched[0][0], watched[-1][0] - SETTLE_NS
    codec = MavlinkCodec(255, 0)
    messages = [(t_ns, message) for t_ns, data in sent for message in codec.parse(data) if t_ns > seen[0][0]]
    during = [m.get_msgId() for t_ns, m in messages if begin_ns <= t_ns <= end_ns]
    assert set(during) == {dialect.MAVLINK_MSG_ID_HEARTBEAT}
    assert len(during) <= (end_ns - begin_ns) * 1e-9 + 2
    others = [m for _, m in messages if m.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT]
    assert {getattr(m, "command", 0) for m in others} <= {dialect.MAV_CMD_SET_MESSAGE_INTERVAL}
