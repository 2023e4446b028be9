"""A relay on UDP between autopilot and vehicle bridge that times odometry and setpoints, and others beside them.

`python -m benchmarks.speed.mavlink_proxy BRIDGE_PORT OWN_PORT BARE_PORT BY_HAND_PORT` listens where the instance's
bridge would, and speaks to the bridge from OWN_PORT. Three steps of the autopilot after each odometry, when the machine
does the same as at the odometry itself, it sends the same bytes to one of the other exchanges, `benchmarks.speed.bare`
or `by_hand`, which answers; fifty to the one, then fifty to the other. On SIGTERM it prints one `Times` as JSON. What
the bridge and the others send is timed by the kernel, as it leaves them.
"""

import contextlib
import select
import signal
import socket
import struct
import sys
import time

import msgspec

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.instance import Instance, instance_from_environment

HOST = "127.0.0.1"
SO_TIMESTAMPNS = 35
OTHER_AFTER_NS = 12_000_000
"""Three steps of autopilot and simulator, and more than half a period of odometry."""
IN_A_ROW = 50
ODOMETRY_ID = dialect.MAVLINK_MSG_ID_ODOMETRY.to_bytes(3, "little")
"""Message id as in the header of a frame."""
Passed = tuple[int, bytes]


class Times(msgspec.Struct, frozen=True):
    """Times of messages, in ns of the realtime clock.

    Attributes:
        odometry_ns: times of odometry.
        setpoint_ns: times of setpoints.
        bare_ns: durations of bare exchanges, from sending until their reply is sent.
        bare_zenoh_ns: durations of Zenoh's part of the bare exchanges, which their replies carry.
        by_hand_ns: durations of exchanges by hand, from sending until their reply is sent.
    """

    odometry_ns: list[int]
    setpoint_ns: list[int]
    bare_ns: list[int]
    bare_zenoh_ns: list[int]
    by_hand_ns: list[int]


def kernel_time_ns(receiver: socket.socket) -> Passed:
    """Receive a datagram with the time at which it was sent on this host. Needs SO_TIMESTAMPNS."""
    data, notes, _, _ = receiver.recvmsg(65536, 64)
    seconds, ns = struct.unpack("qq", notes[0][2])
    return seconds * 1_000_000_000 + ns, data


class Other:
    """Another exchange, by its UDP port.

    Attributes:
        taken: begin and reply of each exchange.
    """

    def __init__(self, port: int) -> None:
        self.socket = _timing_socket(port)
        self.taken: list[tuple[int, Passed]] = []
        self._sent_ns = 0

    def begin(self, data: bytes) -> None:
        self._sent_ns = time.time_ns()
        with contextlib.suppress(ConnectionRefusedError):  # it is not there yet
            self.socket.send(data)

    def end(self) -> None:
        reply = kernel_time_ns(self.socket)
        self.taken.append((self._sent_ns, reply))

    @property
    def durations_ns(self) -> list[int]:
        return [end_ns - begin_ns for begin_ns, (end_ns, _) in self.taken]


def _timing_socket(port: int) -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    end.connect((HOST, port))
    return end


class Relay:
    """Passes datagrams on and records them.

    Attributes:
        to_bridge: datagrams to the bridge, with times in ns.
        from_bridge: datagrams from the bridge, with times in ns.
        bare: the bare exchange.
        by_hand: the exchange by hand.
    """

    def __init__(self, instance: Instance, bridge_port: int, own_port: int, bare_port: int, by_hand_port: int) -> None:
        self.to_bridge: list[Passed] = []
        self.from_bridge: list[Passed] = []
        self.bare, self.by_hand = Other(bare_port), Other(by_hand_port)
        self._outer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._outer.bind((HOST, instance.bridge_port))
        self._inner = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._inner.bind((HOST, own_port))
        self._inner.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._inner.connect((HOST, bridge_port))
        self._autopilot: tuple[str, int] | None = None
        self._odometry = b""
        self._others_due_ns: int | None = None
        self._others_begun = 0

    def run(self, stop: socket.socket) -> None:
        """Relay until `stop` is readable, then free the ports."""
        handlers = {
            self._outer: self._from_autopilot,
            self._inner: self._from_bridge,
            self.bare.socket: self.bare.end,
            self.by_hand.socket: self.by_hand.end,
        }
        with self._outer, self._inner, self.bare.socket, self.by_hand.socket:
            while True:
                wait_s = None
                if self._others_due_ns is not None:
                    wait_s = max(0, self._others_due_ns - time.time_ns()) * 1e-9
                ready, _, _ = select.select([*handlers, stop], [], [], wait_s)
                if stop in ready:
                    return
                for end in ready:
                    with contextlib.suppress(ConnectionRefusedError):  # the other side is not there yet
                        handlers[end]()
                if self._others_due_ns is not None and time.time_ns() >= self._others_due_ns:
                    self._begin_other()

    def _from_autopilot(self) -> None:
        data, self._autopilot = self._outer.recvfrom(65536)
        now_ns = time.time_ns()
        self.to_bridge.append((now_ns, data))
        if ODOMETRY_ID in data:
            self._odometry = data
            self._others_due_ns = now_ns + OTHER_AFTER_NS
        self._inner.send(data)

    def _from_bridge(self) -> None:
        t_ns, data = kernel_time_ns(self._inner)
        self.from_bridge.append((t_ns, data))
        if self._autopilot is not None:
            self._outer.sendto(data, self._autopilot)

    def _begin_other(self) -> None:
        self._others_due_ns = None
        self._others_begun += 1
        other = self.by_hand if self._others_begun // IN_A_ROW % 2 else self.bare
        other.begin(self._odometry)


def times_of(passed: list[Passed], message_id: int) -> list[int]:
    """Times of messages of one kind, in ns."""
    codec = MavlinkCodec(255, 0)
    return [t_ns for t_ns, data in passed for message in codec.parse(data) if message.get_msgId() == message_id]


def main() -> None:
    stop_read, stop_write = socket.socketpair()
    signal.signal(signal.SIGTERM, lambda _number, _frame: stop_write.close())
    relay = Relay(instance_from_environment(), *map(int, sys.argv[1:5]))
    relay.run(stop_read)
    times = Times(
        odometry_ns=times_of(relay.to_bridge, dialect.MAVLINK_MSG_ID_ODOMETRY),
        setpoint_ns=times_of(relay.from_bridge, dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED),
        bare_ns=relay.bare.durations_ns,
        bare_zenoh_ns=[int.from_bytes(data[:8], "little") for _, (_, data) in relay.bare.taken],
        by_hand_ns=relay.by_hand.durations_ns,
    )
    print(msgspec.json.encode(times).decode())


if __name__ == "__main__":
    main()
