"""Where the pages are served, and what another address than the loopback address needs."""

import socket
from pathlib import Path

import pytest

pytest.importorskip("argon2", reason="the extra jezero[ground] is not installed")

from jezero.runtime.config import ConfigError
from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.listening import Listening, insecurities, listening_of, listening_socket
from jezero.services.ground_station.password import write_password

OUTSIDE = "192.0.2.7"


@pytest.fixture
def password_file(tmp_path: Path) -> str:
    """A file with a password."""
    write_password(tmp_path / "password", "correct horse")
    return str(tmp_path / "password")


def test_on_the_loopback_address_anybody_may_fly() -> None:
    assert listening_of(GroundStationConfig()).password_hash == ""
    assert GroundStationConfig().listen == "127.0.0.1"
    assert listening_of(GroundStationConfig(listen="::1")).password_hash == ""


@pytest.mark.parametrize("address", [OUTSIDE, "0.0.0.0", "::"])
def test_another_address_needs_a_password(address: str, tmp_path: Path) -> None:
    config = GroundStationConfig(listen=address, insecure=True, password_file=str(tmp_path / "none"))
    with pytest.raises(ConfigError, match="--set-password"):
        listening_of(config)


def test_another_address_needs_tls_or_the_word_insecure(password_file: str) -> None:
    with pytest.raises(ConfigError, match=r"--certificate.*--insecure"):
        listening_of(GroundStationConfig(listen=OUTSIDE, password_file=password_file))
    listening = listening_of(GroundStationConfig(listen=OUTSIDE, password_file=password_file, insecure=True))
    assert listening.password_hash
    assert listening.url(8080) == f"http://{OUTSIDE}:8080"


def test_what_is_without_tls_is_named(password_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    on_loopback = listening_of(GroundStationConfig())
    assert insecurities(on_loopback, "tcp/127.0.0.1:7447") == insecurities(on_loopback, None) == ""
    assert insecurities(on_loopback, "tcp/10.0.0.1:7447") == (
        "tcp/10.0.0.1:7447 is insecure: whoever is on its network sees all and may fly"
    )
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    monkeypatch.setenv("JEZERO_LISTEN", "tcp/0.0.0.0:7448")
    assert insecurities(on_loopback, "tcp/127.0.0.1:7447").startswith("tcp/0.0.0.0:7448 is insecure")
    outside = listening_of(GroundStationConfig(listen=OUTSIDE, password_file=password_file, insecure=True))
    assert "; These pages are insecure" in insecurities(outside, "tcp/127.0.0.1:7447")


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"listen": "the roof"}, "is no IP address"),
        ({"certificate": "cert.pem"}, "needs both files"),
        ({"certificate": "no.pem", "key": "no.pem"}, "no such file"),
        ({"certificate": __file__, "key": __file__}, "no certificate"),
    ],
)
def test_wrong_settings_get_a_sentence(settings: dict[str, str], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        listening_of(GroundStationConfig(**settings))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("address", "host", "served"),
    [
        ("127.0.0.1", "127.0.0.1:8080", True),
        ("127.0.0.1", "LOCALHOST:8080", True),
        ("::1", "[::1]:8080", True),
        ("127.0.0.1", "192.0.2.7:8080", False),
        ("127.0.0.1", "example.org:8080", False),
        ("127.0.0.1", "", False),
        ("127.0.0.1", "127.0.0.1.example.org", False),
        ("127.0.0.1", "user@example.org:8080", False),
        (OUTSIDE, "192.0.2.7:8080", True),
        (OUTSIDE, "rover.example:8080", True),
        (OUTSIDE, "example.org:8080", False),
    ],
)
def test_requests_that_name_another_machine_are_not_served(address: str, host: str, served: bool) -> None:
    names = frozenset() if address != OUTSIDE else frozenset({"rover.example"})
    assert Listening(address, "", "", "", names).serves(host) is served


def test_a_busy_port_is_left_and_the_next_free_one_is_taken() -> None:
    with listening_socket("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with listening_socket("127.0.0.1", port) as second:
            assert second.getsockname() != first.getsockname()
            assert second.getsockname()[0] == "127.0.0.1"


def test_it_listens_on_the_given_address_only() -> None:
    with listening_socket("127.0.0.2", 0) as listening:
        assert listening.getsockname()[0] == "127.0.0.2"
        with pytest.raises(ConnectionRefusedError), socket.socket() as other:
            other.connect(("127.0.0.3", listening.getsockname()[1]))


def test_an_address_of_another_machine_gets_a_sentence() -> None:
    with pytest.raises(OSError, match="no address of this machine"):
        listening_socket(OUTSIDE, 0)
