"""Where the pages are served, what another address than the loopback address needs, and who has logged in."""

import socket
import stat
from pathlib import Path

import pytest

pytest.importorskip("argon2", reason="the extra jezero[ground] is not installed")

from jezero.base.config import ConfigError
from jezero.services.ground_station.access import (
    ADDRESSES_MAX,
    SESSIONS_MAX,
    Listening,
    LoginLimiter,
    Sessions,
    hash_of,
    insecurities,
    listening_of,
    listening_socket,
    matches,
    read_password,
    write_password,
)
from jezero.services.ground_station.config import GroundStationConfig

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
    assert Listening(GroundStationConfig(listen=address), names=names).serves(host) is served


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


def test_a_hash_matches_its_own_password_only() -> None:
    hashed = hash_of("correct horse")
    assert matches("correct horse", hashed)
    assert not matches("correct horsf", hashed)
    assert not matches("", hashed)
    assert "horse" not in hashed
    assert hash_of("correct horse") != hashed  # each has a salt of its own


def test_the_file_can_be_read_by_its_owner_only_also_when_it_replaces_one_that_others_could_read(
    tmp_path: Path,
) -> None:
    file = tmp_path / "folder" / "password"
    file.parent.mkdir()
    file.touch(0o644)
    write_password(file, "correct horse")
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert matches("correct horse", read_password(file))


@pytest.mark.parametrize("password", ["short", "x" * 201])
def test_a_password_of_a_wrong_length_is_refused(tmp_path: Path, password: str) -> None:
    with pytest.raises(ValueError, match="choose 8 to 200"):
        write_password(tmp_path / "password", password)
    assert not list(tmp_path.iterdir())


def test_a_file_that_others_can_read_is_refused_with_the_command_that_helps(tmp_path: Path) -> None:
    file = tmp_path / "password"
    write_password(file, "correct horse")
    file.chmod(0o640)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_password(file)


@pytest.mark.parametrize(
    "content", ["", "correct horse", "scrypt 32768 8 1 AAAA AAAA", "$argon2id$v=19$m=19456,t=2,p=1$AAAA", "\x80"]
)
def test_a_damaged_file_is_refused_and_so_is_another_kind_of_hash(tmp_path: Path, content: str) -> None:
    file = tmp_path / "password"
    file.write_text(content, encoding="latin-1")
    file.chmod(0o600)
    with pytest.raises(ConfigError, match="no Argon2 hash: `jezero ground --set-password`"):
        read_password(file)


def test_a_session_that_is_not_used_ends_after_its_idle_time() -> None:
    sessions = Sessions(idle_s=100.0, max_s=1000.0)
    session = sessions.begin(0.0)
    assert sessions.use(session, 60.0)
    assert sessions.remaining_s(session, 110.0) == 50.0
    assert not sessions.use(session, 160.0)
    assert sessions.remaining_s(session, 160.0) == 0.0


def test_a_session_ends_after_its_absolute_time_though_it_is_used() -> None:
    sessions = Sessions(idle_s=100.0, max_s=150.0)
    session = sessions.begin(0.0)
    assert sessions.use(session, 90.0)
    assert sessions.remaining_s(session, 100.0) == 50.0
    assert not sessions.use(session, 150.0)


def test_an_ended_or_unknown_session_is_none() -> None:
    sessions = Sessions(idle_s=100.0, max_s=150.0)
    session = sessions.begin(0.0)
    sessions.end(session)
    assert not sessions.use(session, 1.0)
    assert not sessions.use("", 1.0)
    assert not sessions.use("ä", 1.0)


def test_the_oldest_session_ends_when_there_are_too_many() -> None:
    sessions = Sessions(idle_s=100.0, max_s=150.0)
    begun = [sessions.begin(0.0) for _ in range(SESSIONS_MAX + 1)]
    assert not sessions.use(begun[0], 1.0)
    assert all(sessions.use(session, 1.0) for session in begun[1:])


def test_an_address_waits_after_five_wrong_passwords_and_others_do_not() -> None:
    limiter = LoginLimiter()
    for t_s in (0.0, 1.0, 2.0, 3.0):
        limiter.on_failure("192.0.2.1", t_s)
    assert limiter.wait_s("192.0.2.1", 4.0) == 0.0
    limiter.on_failure("192.0.2.1", 4.0)
    assert limiter.wait_s("192.0.2.1", 10.0) == 50.0
    assert limiter.wait_s("192.0.2.2", 10.0) == 0.0
    assert limiter.wait_s("192.0.2.1", 60.0) == 0.0


def test_the_addresses_of_one_ipv6_network_are_one() -> None:
    limiter = LoginLimiter()
    for number in range(5):
        limiter.on_failure(f"2001:db8::{number}", 0.0)
    assert limiter.wait_s("2001:db8::ffff", 1.0) > 0.0
    assert limiter.wait_s("2001:db8:0:1::1", 1.0) == 0.0


def test_a_right_password_forgets_the_wrong_ones() -> None:
    limiter = LoginLimiter()
    for _ in range(5):
        limiter.on_failure("192.0.2.1", 0.0)
    limiter.on_success("192.0.2.1")
    assert limiter.wait_s("192.0.2.1", 1.0) == 0.0


def test_the_table_of_addresses_is_bounded_and_the_oldest_ones_leave_it() -> None:
    limiter = LoginLimiter()
    for number in range(5):
        limiter.on_failure("192.0.2.1", float(number))
    for number in range(ADDRESSES_MAX):
        limiter.on_failure(f"10.0.{number // 256}.{number % 256}", 5.0)
    assert limiter.wait_s("192.0.2.1", 6.0) == 0.0
