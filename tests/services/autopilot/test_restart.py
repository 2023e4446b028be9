"""A signed MAVLink message that was captured counts for nothing after a restart of the autopilot."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from jezero.base.config import config_directory
from jezero.base.mavlink import UNIX_2015_S, MavlinkCodec, Signing, dialect
from jezero.deploy.launcher.ports import reserved_instance, service_environment
from jezero.runtime.instance import Instance, socket_of
from jezero.runtime.routing import open_router
from jezero.services.autopilot.ground_link import STAMP_NAME, load_stamp, save_stamp
from tests.services.autopilot.test_mavlink_fuzz import KEY

pytestmark = pytest.mark.process

TIMEOUT_S = 60.0
SILENCE_S = 1.0
"""An autopilot that runs acknowledges a command within some ms."""
COMMAND = dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES
NOW = 1_000_000_000


def clocked(signing: Signing, clock_10us: int) -> Signing:
    signing.clock_10us = clock_10us
    return signing


def accepts(receiver: Signing, stamp_10us: int) -> bool:
    """Whether a receiver accepts a message that is signed with a time stamp."""
    sender = MavlinkCodec(255, 190, clocked(Signing(KEY), stamp_10us))
    (message,) = MavlinkCodec(1, 1).parse(sender.pack(dialect.MAVLink_ping_message(0, 0, 1, 1)))
    return receiver.accepts(message)


def test_nothing_that_was_accepted_before_a_restart_is_accepted_after_it_however_late_the_last_write_was() -> None:
    kept: list[int] = []
    before = clocked(Signing(KEY, keep=kept.append), NOW)
    stamps = [NOW + step for step in range(0, 700_000, 1000)]
    assert all(accepts(before, stamp) for stamp in stamps)
    assert kept == [NOW + Signing.AHEAD, NOW + 501_000 + Signing.AHEAD], "700 messages of 7 s are two writes"
    after = clocked(Signing(KEY, kept[-1], kept.append), NOW + 700_000)
    assert not any(accepts(after, stamp) for stamp in (*stamps, kept[-1]))
    assert accepts(after, kept[-1] + 1)


def test_a_time_stamp_is_kept_before_its_message_is_accepted() -> None:
    def fail(_: int) -> None:
        raise InterruptedError

    receiver = clocked(Signing(KEY, keep=fail), NOW)
    with pytest.raises(InterruptedError):
        accepts(receiver, NOW)


def test_a_message_without_the_key_is_not_worth_a_write() -> None:
    kept: list[int] = []
    receiver = clocked(Signing(KEY[::-1], keep=kept.append), NOW)
    assert not accepts(receiver, NOW)
    assert kept == []


def test_the_file_keeps_the_time_stamp_and_a_damaged_one_counts_as_the_latest(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / STAMP_NAME
    assert load_stamp(path, NOW) == load_stamp(None, NOW) == -1
    save_stamp(path, 77)
    save_stamp(path, NOW + 5)
    assert load_stamp(path, NOW) == NOW + 5
    assert [each.name for each in tmp_path.iterdir()] == [STAMP_NAME]
    path.write_bytes(b"\xff\x00")
    assert load_stamp(path, NOW) == NOW + Signing.WINDOW
    assert "mavlink_stamp is damaged: no signed message is accepted for about 60 s" in capfd.readouterr().err
    save_stamp(tmp_path / "missing" / STAMP_NAME, 1)
    assert "after a restart a captured MAVLink message could be accepted" in capfd.readouterr().err


class Station:
    """A ground station at the autopilot's port for them."""

    def __init__(self, instance: Instance, link: socket.socket) -> None:
        self._to = ("127.0.0.1", instance.autopilot_gcs_port)
        self._command = dialect.MAVLink_command_long_message(instance.system_id, 1, COMMAND, 0, *[0.0] * 7)
        self._link = link
        self._reader = MavlinkCodec(255, 190)

    def signed_now(self) -> bytes:
        """A command that is signed now."""
        clock = clocked(Signing(KEY), int((time.time() - UNIX_2015_S) * 1e5))
        return MavlinkCodec(255, 190, clock).pack(self._command)

    def is_acknowledged(self, data: bytes, within_s: float = SILENCE_S) -> bool:
        """Send a command; returns whether it is acknowledged in time."""
        self._link.sendto(data, self._to)
        deadline_s = time.monotonic() + within_s
        while (rest_s := deadline_s - time.monotonic()) > 0.0:
            self._link.settimeout(rest_s)
            try:
                messages = self._reader.parse(self._link.recv(65536))
            except (TimeoutError, ConnectionRefusedError):
                continue
            if any(message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK for message in messages):
                return True
        return False

    def command_that_is_acknowledged(self) -> bytes:
        """Sign commands until the autopilot has started and accepts one, which is returned."""
        deadline_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() < deadline_s:
            if self.is_acknowledged(data := self.signed_now(), within_s=0.3):
                return data
        raise AssertionError("the autopilot accepts no signed command")


@contextmanager
def autopilot(environment: dict[str, str]) -> Iterator[None]:
    """The process of the autopilot; it is killed at the end, as by a loss of power."""
    process = subprocess.Popen([sys.executable, "-m", "jezero.services.autopilot"], env=environment)
    try:
        yield
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


def test_a_captured_command_is_not_carried_out_again_after_the_process_was_killed(tmp_path: Path) -> None:
    settings = shutil.copytree(config_directory(), tmp_path / "config")
    (settings / "autopilot.toml").write_text(f'[signing]\nkey = "{KEY.hex()}"\n')
    with (
        reserved_instance() as instance,
        open_router(instance.router, socket_of(tmp_path)),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link,
    ):
        link.bind(("127.0.0.1", 0))
        environment = os.environ | service_environment(instance, tmp_path) | {
            "JEZERO_CONFIG_DIR": str(settings),
            "JEZERO_GCS_PORT": str(link.getsockname()[1]),
            "JEZERO_RECORD": "0",
        }  # fmt: skip
        station = Station(instance, link)
        with autopilot(environment):
            captured = station.command_that_is_acknowledged()
            assert not station.is_acknowledged(captured), "a replay to the same process"
        with autopilot(environment):
            fresh = station.command_that_is_acknowledged()
            assert not station.is_acknowledged(captured), "a replay to the next process"
            assert not station.is_acknowledged(fresh)
        (tmp_path / STAMP_NAME).unlink()
        with autopilot(environment):
            deadline_s = time.monotonic() + TIMEOUT_S
            while not station.is_acknowledged(fresh, within_s=0.3):  # without the file the same replay is carried out
                assert time.monotonic() < deadline_s
