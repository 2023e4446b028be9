"""A relay on UDP between autopilot and vehicle bridge that notes when odometry and setpoints pass.

`python -m benchmarks.mavlink_proxy BRIDGE_PORT` listens where the instance's bridge would; on SIGTERM it prints one
JSON object: times in ns of the realtime clock. A setpoint's is the kernel's, taken when the bridge sent it.
"""

import json
import select
import signal
import socket
import struct
import sys
import time

from jezero.mavlink import MavlinkCodec, dialect
from jezero.runtime.config import Instance, instance_from_environment

HOST = "127.0.0.1"
SO_TIMESTAMPNS = 35
Passed = tuple[int, bytes]


def kernel_time_ns(receiver: socket.socket) -> tuple[int, bytes]:
    """A datagram and when it was sent on this host. Needs SO_TIMESTAMPNS."""
    data, notes, _, _ = receiver.recvmsg(65536, 64)
    seconds, ns = struct.unpack("qq", notes[0][2])
    return seconds * 1_000_000_000 + ns, data


def relay(instance: Instance, bridge_port: int) -> tuple[list[Passed], list[Passed]]:
    """Until SIGTERM: what went to the bridge and what came from it, with times in ns."""
    outer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    inner = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stop_read, stop_write = socket.socketpair()
    signal.signal(signal.SIGTERM, lambda _number, _frame: stop_write.close())
    to_bridge: list[Passed] = []
    from_bridge: list[Passed] = []
    with outer, inner, stop_read:
        outer.bind((HOST, instance.bridge_port))
        inner.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        inner.connect((HOST, bridge_port))
        autopilot = None
        while True:
            ready, _, _ = select.select([outer, inner, stop_read], [], [])
            if stop_read in ready:
                return to_bridge, from_bridge
            try:
                if outer in ready:
                    data, autopilot = outer.recvfrom(65536)
                    to_bridge.append((time.time_ns(), data))
                    inner.send(data)
                if inner in ready:
                    t_ns, data = kernel_time_ns(inner)
                    from_bridge.append((t_ns, data))
                    if autopilot is not None:
                        outer.sendto(data, autopilot)
            except ConnectionRefusedError:  # the bridge is not there yet
                continue


def times_of(passed: list[Passed], message_id: int) -> list[int]:
    """When messages of one kind passed, in ns."""
    codec = MavlinkCodec(255, 0)
    return [t_ns for t_ns, data in passed for message in codec.parse(data) if message.get_msgId() == message_id]


def main() -> None:
    to_bridge, from_bridge = relay(instance_from_environment(), int(sys.argv[1]))
    odometry = times_of(to_bridge, dialect.MAVLINK_MSG_ID_ODOMETRY)
    setpoints = times_of(from_bridge, dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)
    print(json.dumps({"odometry_ns": odometry, "setpoint_ns": setpoints}))


if __name__ == "__main__":
    main()
