"""Lines between the simulator and the rover's computer: messages come through, anything else is dropped."""

import pytest

from jezero.base.config import ConfigError
from jezero.base.lines import LINE_MAX_BYTES
from jezero.base.rover_link import MessageLines, line_of
from jezero.runtime.instance import Instance, checked_host
from jezero.runtime.node import LINK_BYTES_MAX, Mailbox
from jezero.schemas.commands import RoverCommand

COMMAND = RoverCommand(t_ns=1, speed_rover_body_mps=0.5, yaw_rate_rover_rps=-0.25)


def test_a_message_comes_through_byte_by_byte() -> None:
    lines = MessageLines(RoverCommand)
    received = [message for byte in line_of(COMMAND) for message in lines.receive(bytes([byte]))]
    assert received == [COMMAND]


def test_a_line_without_end_takes_no_memory_and_counts_as_one_bad_message() -> None:
    lines = MessageLines(RoverCommand)
    for _ in range(100):
        assert lines.receive(b"1" * LINE_MAX_BYTES) == []
        assert len(lines._lines.rest) <= LINE_MAX_BYTES + 1
    assert lines.receive(b"\n" + line_of(COMMAND)) == [COMMAND]
    assert lines.dropped == 1


@pytest.mark.parametrize(
    "line",
    [b"", b"\xff\xfe", b"null", b"[" * 4000, b'{"t_ns":1}', line_of(COMMAND).replace(b"0.5", b"9.5").strip()],
)
def test_what_is_no_command_is_dropped(line: bytes) -> None:
    lines = MessageLines(RoverCommand)
    assert lines.receive(line + b"\n" + line_of(COMMAND)) == [COMMAND]
    assert lines.dropped == 1


def test_bytes_that_no_step_reads_fill_no_memory() -> None:
    mailbox = Mailbox(["rover"])
    for _ in range(10):
        mailbox.add_bytes("rover", b"x" * (LINK_BYTES_MAX // 4))
    assert len(mailbox.received("rover")) == LINK_BYTES_MAX
    mailbox.clear()
    mailbox.add_bytes("rover", b"next")
    assert mailbox.received("rover") == b"next"


def test_no_two_instances_share_a_port_between_autopilots_and_rovers() -> None:
    numbers = range(250)
    hil = {Instance(number=number).hil_port for number in numbers}
    assert not hil & {Instance(number=number).rover_port for number in numbers}


def test_another_computer_is_refused_without_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_INSECURE", raising=False)
    assert checked_host("JEZERO_SIMULATOR", "localhost") == "localhost"
    for host in ("0.0.0.0", "10.0.0.7", "rover.local"):
        with pytest.raises(ConfigError, match=r"JEZERO_SIMULATOR .* JEZERO_INSECURE=1"):
            checked_host("JEZERO_SIMULATOR", host)
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    assert checked_host("JEZERO_SIMULATOR", "10.0.0.7") == "10.0.0.7"


@pytest.mark.parametrize("host", ["", "::1", "10.0.0.7:4810", "tcp/10.0.0.7", "a b"])
def test_what_is_no_host_is_refused_by_the_name_of_its_setting(host: str) -> None:
    with pytest.raises(ConfigError, match=r"rover_host is .* without a port"):
        checked_host("rover_host", host)
