"""The ground station is lost in flight: the autopilot's failsafe lands, and the bridge does not interfere."""

import os
import socket
import struct
import threading
import time
from collections.abc import Iterator

import pytest

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.instance import Instance
from jezero.schemas.state import StatusCode
from tests.system.bridge_observation import HOST
from tests.system.conftest import Stack, wait_for, wait_for_status

AUTOPILOTS = [
    pytest.param("embedded", marks=pytest.mark.slow),  # tests/scenario/test_failsafes.py flies it in virtual time
    pytest.param(
        "px4",
        marks=pytest.mark.skipif(
            not os.environ.get("JEZERO_PX4_DIR"), reason="JEZERO_PX4_DIR names no folder with PX4's bin/px4 and etc/"
        ),
    ),
]
LAND = 3
LOSS_S = 12.5
"""Default of COM_DL_LOSS_T, in vehicle time, after the 2.5 s for which a heartbeat counts."""
HOLD_S = 5.0
"""Default of COM_FAIL_ACT_T, the time that PX4 waits before it acts."""
LANDS_WITHIN_S = 60.0


class GroundStation:
    """Sends heartbeats twice a second from the start until `stop_heartbeats`, and sets parameters.

    PX4 replies to the first sender on this link, the embedded autopilot to the ground station's port only.
    """

    def __init__(self, instance: Instance, port: int) -> None:
        self._instance = instance
        self._codec = MavlinkCodec(255, 190)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, port))
        self._socket.setblocking(False)
        self._stopped = threading.Event()
        self._heartbeats = threading.Thread(target=self._send_heartbeats, daemon=True)
        self._heartbeats.start()

    def _send_heartbeats(self) -> None:
        codec = MavlinkCodec(255, 190)
        beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        while True:
            self._send(codec.pack(beat))
            if self._stopped.wait(0.5):
                return

    def _send(self, data: bytes) -> None:
        self._socket.sendto(data, (HOST, self._instance.autopilot_gcs_port))

    def set(self, name: str, value: int) -> None:
        """Set an integer parameter, and wait until the autopilot reports this value."""
        carried = struct.unpack("<f", struct.pack("<i", value))[0]
        kind = dialect.MAV_PARAM_TYPE_INT32
        message = dialect.MAVLink_param_set_message(self._instance.system_id, 1, name.encode(), carried, kind)
        resend_s = 0.0

        def is_set() -> bool:
            nonlocal resend_s
            if time.monotonic() > resend_s:
                resend_s = time.monotonic() + 0.5
                self._send(self._codec.pack(message))
            return (name, value) in self._reported()

        wait_for(is_set, 10.0, f"{name} set to {value}")

    def _reported(self) -> Iterator[tuple[str, int]]:
        """Integer parameters that the autopilot has reported since the last call."""
        while True:
            try:
                data = self._socket.recv(65536)
            except BlockingIOError:
                return
            for message in self._codec.parse(data):
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
                    yield message.param_id, struct.unpack("<i", struct.pack("<f", message.param_value))[0]

    def stop_heartbeats(self) -> None:
        self._stopped.set()
        self._heartbeats.join()

    def close(self) -> None:
        self.stop_heartbeats()
        self._socket.close()


@pytest.mark.long
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_without_its_ground_station_it_lands_if_the_parameter_says_so(autopilot: str, unstarted: Stack) -> None:
    unstarted.choose_autopilot(autopilot)
    stack = unstarted.up()
    port = 0 if autopilot == "px4" else int(stack.environment["JEZERO_GCS_PORT"])
    station = GroundStation(stack.instance, port)
    try:
        with stack.connect() as vehicle:
            wait_for_status(vehicle, lambda s: s.ready, 60, "ready")
            vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)
            station.set("NAV_DLL_ACT", LAND)
            wait_for_status(vehicle, lambda s: s.code == StatusCode.HOVER, 10.0, "hovering")
            station.stop_heartbeats()
            stopped_ns = vehicle.status().t_ns
            wait_for_status(vehicle, lambda s: s.code != StatusCode.HOVER, 4 * LOSS_S, "the link is lost")
            lost = vehicle.status()
            assert LOSS_S - 1.0 < (lost.t_ns - stopped_ns) * 1e-9 < LOSS_S + 1.0
            assert (lost.code, lost.in_charge) == (StatusCode.EXTERNAL, "failsafe")
            landing_timeout_s = 4 * HOLD_S + 5.0
            wait_for_status(vehicle, lambda s: s.autopilot_mode == "AUTO.LAND", landing_timeout_s, "landing")
            wait_for_status(vehicle, lambda s: s.code == StatusCode.IDLE, LANDS_WITHIN_S, "landed and disarmed")
            assert not vehicle.status().armed
    finally:
        station.close()
