"""Who gets into a router that listens with a bundle: real Zenoh sessions, on the loopback."""

import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh

from jezero.base.zenoh_client import client_config
from jezero.keys.bundle import secured
from jezero.keys.members import KeysError, read_members
from jezero.keys.team import Team
from tests.keys.rig import access_control, add_at, make_team, router

pytestmark = pytest.mark.process

CONNECT_TIMEOUT_S = 0.6
"""A link with TLS is there after 10 ms; a refused one is tried again until this time."""


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Team:
    return make_team(tmp_path_factory.mktemp("a folder = #1") / "team")


def gets_in(endpoint: str) -> bool:
    """Whether a client gets a session with the router at an endpoint."""
    try:
        with zenoh.open(client_config(endpoint, CONNECT_TIMEOUT_S)) as session:
            return bool(list(session.info.routers_zid()))
    except zenoh.ZError:
        return False


@pytest.mark.parametrize("member", ["vehicle-uav1", "ground-lab", "pilot-ana", "viewer-eye"])
def test_every_member_gets_in_under_each_host_of_the_certificate(team: Team, member: str) -> None:
    with router(team.bundle("vehicle-uav1")) as (port, _):
        for host in ("127.0.0.1", "127.0.0.2", "localhost"):
            assert gets_in(secured(f"tls/{host}:{port}", team.bundle(member))), host


def test_a_stranger_does_not_get_in(team: Team, tmp_path: Path) -> None:
    others = make_team(tmp_path / "others")
    own = team.bundle("pilot-ana")
    with router(team.bundle("vehicle-uav1")) as (port, _):
        address = f"tls/127.0.0.1:{port}"
        authority = f"root_ca_certificate_file={own / 'ca.pem'}"
        other = others.bundle("pilot-ana")
        their_certificate = (
            f"{authority};connect_certificate_file={other / 'certificate.pem'};"
            f"connect_private_key_file={other / 'key.pem'};enable_mtls=true"
        )
        assert gets_in(secured(address, own))
        assert not gets_in(f"tcp/127.0.0.1:{port}")
        assert not gets_in(address), "without any bundle"
        assert not gets_in(f"{address}#{authority}"), "with the authority's certificate, and none of its own"
        assert not gets_in(secured(address, other)), "with another team's bundle"
        assert not gets_in(f"{address}#{their_certificate}"), "with another team's certificate"
        assert gets_in(secured(address, own))


def test_a_certificate_counts_only_while_it_is_valid(team: Team) -> None:
    with router(team.bundle("vehicle-uav1")) as (port, _):
        address = f"tls/127.0.0.1:{port}"
        assert not gets_in(secured(address, add_at(team, -400, "pilot", "past")))
        assert not gets_in(secured(address, add_at(team, +5, "pilot", "future")))
        assert gets_in(secured(address, add_at(team, -300, "pilot", "present")))
    with router(add_at(team, -400, "vehicle", "past")) as (port, _):
        assert not gets_in(secured(f"tls/127.0.0.1:{port}", team.bundle("pilot-ana"))), "an expired router"


def test_a_client_takes_no_router_for_one_that_it_is_not(team: Team) -> None:
    own = team.bundle("pilot-ana")
    with router(team.bundle("vehicle-uav1")) as (port, _):
        assert not gets_in(secured(f"tls/127.0.0.3:{port}", own)), "an address that isn't in the certificate"
    with router(team.bundle("viewer-eye")) as (port, _):
        assert not gets_in(secured(f"tls/127.0.0.1:{port}", own)), "a viewer that plays a router"


def test_a_renewed_member_gets_in_with_its_old_key(tmp_path: Path) -> None:
    team = make_team(tmp_path)
    bundle = add_at(team, -400, "pilot", "cy")
    with router(team.bundle("vehicle-uav1")) as (port, _):
        endpoint = secured(f"tls/127.0.0.1:{port}", bundle)
        assert not gets_in(endpoint)
        team.renew("pilot-cy")
        assert gets_in(endpoint)


@pytest.mark.long
def test_a_standing_link_outlives_its_certificate_and_comes_back_with_a_renewed_one(tmp_path: Path) -> None:
    team = make_team(tmp_path)
    a_year_ago = Team(team.folder, datetime.now(UTC) - timedelta(days=365) + timedelta(seconds=5))
    expires = a_year_ago.add("pilot", "cy").expires
    with router(team.bundle("vehicle-uav1")) as (port, _):
        endpoint = secured(f"tls/127.0.0.1:{port}", team.bundle("pilot-cy"))
        client = zenoh.open(client_config(endpoint, 3.0))
        while datetime.now(UTC) <= expires + timedelta(seconds=1):  # certificates count in whole seconds
            time.sleep(0.05)
        assert list(client.info.routers_zid())
        assert not gets_in(endpoint)
    with client, router(team.bundle("vehicle-uav1"), port=port):
        assert not is_back(client, within_s=1.0)
        team.renew("pilot-cy")
        assert is_back(client, within_s=5.0)


def is_back(client: zenoh.Session, within_s: float) -> bool:
    """Whether a session gets its link with the router again."""
    deadline_s = time.monotonic() + within_s
    while not list(client.info.routers_zid()) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return bool(list(client.info.routers_zid()))


def test_the_list_of_members_is_what_access_control_compares(tmp_path: Path) -> None:
    team = make_team(tmp_path)
    assert publishers(team) == {"ana", "bo"}
    team.revoke("pilot-bo")
    assert publishers(team) == {"ana"}


def publishers(team: Team) -> set[str]:
    """Pilots whose messages arrive at a router that allows the pilots in its list of members."""
    bundle = team.bundle("vehicle-uav1")
    settings = access_control(read_members(bundle).allowed("pilot"), "test/**")
    received: list[str] = []
    with router(bundle, settings) as (port, session):
        subscriber = session.declare_subscriber("test/**", lambda sample: received.append(sample.payload.to_string()))
        for name in ("bo", "ana"):  # the one who may in any case is the last
            with zenoh.open(client_config(secured(f"tls/127.0.0.1:{port}", team.bundle(f"pilot-{name}")), 3.0)) as own:
                own.put("test/a", name, congestion_control=zenoh.CongestionControl.BLOCK)
        deadline_s = time.monotonic() + 3.0
        while "ana" not in received and time.monotonic() < deadline_s:
            time.sleep(0.01)
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    return set(received)


def test_a_bundle_that_can_not_be_used_is_refused_with_what_to_do(team: Team, tmp_path: Path) -> None:
    with pytest.raises(KeysError, match=r"ca\.pem is missing: copy the whole folder"):
        secured("tls/127.0.0.1:1", tmp_path)
    with pytest.raises(KeysError, match="';' in its name"):
        secured("tls/127.0.0.1:1", tmp_path / "a;b")
