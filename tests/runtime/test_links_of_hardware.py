"""Links to real hardware: serial lines that are unplugged, datagrams of whoever sends, and addresses that name none."""

import os
import socket
import tty
from pathlib import Path

import pytest

from jezero.base.config import ConfigError
from jezero.runtime.links import SerialLine, TcpClient, Udp, UdpListener, link_of, own_port

S = 1_000_000_000
HOST = "127.0.0.1"


class Device:
    """A pseudo-terminal with the name of a device."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.plug()

    def plug(self) -> None:
        self.end, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._path.symlink_to(os.ttyname(self._slave))

    def pull(self) -> None:
        self._path.unlink()
        os.close(self.end)
        os.close(self._slave)


def test_a_serial_line_that_is_pulled_and_put_back_is_another_connection_and_each_error_is_printed_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ttyACM0"
    device = Device(path)
    line = SerialLine(str(path), 921_600)
    line.start()
    line.poll(0)
    assert (line.up, line.connections) == (True, 1)
    os.write(device.end, b"abc")
    assert line.poll(0) == b"abc"
    line.send(b"back")
    assert os.read(device.end, 100) == b"back"

    device.pull()
    assert line.poll(S) == b""
    assert not line.up
    line.send(b"lost")
    for second in range(2, 8):
        assert line.poll(second * S) == b""
    said = capsys.readouterr().err
    assert said.count("it was unplugged") == 1
    assert said.count("there is no such device: is it plugged in?") == 1

    device.plug()
    line.poll(9 * S)
    assert (line.up, line.connections) == (True, 2)
    line.close()
    device.pull()


def test_a_line_that_another_program_has_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes"
    path.write_text("no device")
    line = SerialLine(str(path), 57_600)
    line.start()
    line.poll(0)
    assert not line.up
    assert f"serial line {path}: it can't be opened" in capsys.readouterr().err


def test_a_listener_answers_its_first_sender_and_hears_another_one_only_after_its_silence() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    listener = UdpListener(HOST, port)
    listener.start()
    listener.send(b"to nobody yet")
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as two,
    ):
        for each in (one, two):
            each.bind((HOST, 0))
            each.settimeout(5)
        one.sendto(b"one", (HOST, port))
        assert listener.poll(0) == b"one"
        assert (listener.up, listener.connections) == (True, 1)
        two.sendto(b"two", (HOST, port))
        one.sendto(b"more", (HOST, port))
        assert listener.poll(S) == b"more"
        listener.send(b"hello")
        assert one.recv(100) == b"hello"
        two.sendto(b"two", (HOST, port))
        assert listener.poll(7 * S) == b"two"
        assert listener.connections == 2
    listener.close()


@pytest.mark.parametrize(
    ("address", "kind"),
    [
        ("serial:/dev/ttyACM0:921600", SerialLine),
        ("udpin:127.0.0.1:14540", UdpListener),
        ("udpout:127.0.0.1:14580", Udp),
        ("tcp:localhost:5760", TcpClient),
    ],
)
def test_an_address_names_a_link(address: str, kind: type) -> None:
    assert isinstance(link_of("link", address), kind)


@pytest.mark.parametrize(
    "address",
    ["/dev/ttyACM0", "serial:ttyACM0:921600", "serial:/dev/ttyACM0", "udp:127.0.0.1:1", "tcp:x:99999", "tcp:x"],
)
def test_a_wrong_address_is_refused_with_what_to_write(address: str) -> None:
    with pytest.raises(ConfigError, match=r"link in x.toml is .*: write serial:DEVICE:BAUD, udpin:ADDRESS:PORT"):
        link_of("link in x.toml", address)


def test_a_link_to_another_computer_needs_a_persons_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="JEZERO_INSECURE"):
        link_of("link in x.toml", "udpin:0.0.0.0:14540")
    with pytest.raises(ConfigError, match=r"write 127\.0\.0\.1, sign it, or set JEZERO_INSECURE=1"):
        link_of("link in x.toml", "udpin:0.0.0.0:14540", remedy="sign it, ")
    assert isinstance(link_of("link in x.toml", "udpin:0.0.0.0:14540", signed=True), UdpListener)
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    assert isinstance(link_of("link in x.toml", "udpin:0.0.0.0:14540"), UdpListener)


def test_udpout_sends_from_the_same_port_after_a_restart_as_px4_replies_to_the_first_one_for_ever() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", 0))
        controller.settimeout(5.0)
        port = controller.getsockname()[1]
        senders = []
        for _ in range(2):
            link = link_of("link", f"udpout:127.0.0.1:{port}")
            link.start()
            link.send(b"hello")
            senders.append(controller.recvfrom(64)[1])
            link.close()
    assert senders[0] == senders[1]
    assert own_port(14_580) == 24_580
    assert own_port(60_000) == 50_000
