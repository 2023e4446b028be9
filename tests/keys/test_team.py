"""The team's folder: authority, members and bundles."""

import stat
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import ECDSA, EllipticCurvePublicKey
from cryptography.x509.oid import ExtendedKeyUsageOID

from jezero.keys.bundle import identity_of, mavlink_key, read_certificate
from jezero.keys.members import ROLES, KeysError, Role, read_members
from jezero.keys.team import Team

NOW = datetime(2027, 3, 1, 12, tzinfo=UTC)


@pytest.fixture
def team(tmp_path: Path) -> Team:
    team = Team(tmp_path / "team", NOW)
    team.found()
    return team


def certificate_of(team: Team, name: str) -> x509.Certificate:
    return read_certificate(team.bundle(name) / "certificate.pem")


def uses_of(certificate: x509.Certificate) -> set[x509.ObjectIdentifier]:
    return set(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)


@pytest.mark.parametrize("role", ROLES)
def test_a_certificate_names_the_member_its_role_and_its_end_and_is_signed_by_the_authority(
    team: Team, role: Role
) -> None:
    team.add(role, "one", days=30)
    certificate = certificate_of(team, f"{role}-one")
    identity = identity_of(certificate)
    assert (identity.name, identity.role) == (f"{role}-one", role)
    assert (identity.begins, identity.expires) == (NOW - timedelta(days=1), NOW + timedelta(days=30))
    authority = read_certificate(team.bundle(f"{role}-one") / "ca.pem")
    public_key = authority.public_key()
    assert isinstance(public_key, EllipticCurvePublicKey)
    assert certificate.signature_hash_algorithm is not None
    public_key.verify(
        certificate.signature, certificate.tbs_certificate_bytes, ECDSA(certificate.signature_hash_algorithm)
    )


def test_only_computers_with_a_router_may_be_connected_to(team: Team) -> None:
    for role in ROLES:
        team.add(role, "one")
        server = ExtendedKeyUsageOID.SERVER_AUTH in uses_of(certificate_of(team, f"{role}-one"))
        assert server == (role in ("vehicle", "rover", "ground")), role
        assert ExtendedKeyUsageOID.CLIENT_AUTH in uses_of(certificate_of(team, f"{role}-one"))


def test_a_router_has_its_hosts_and_those_of_the_loopback_in_its_certificate(team: Team) -> None:
    team.add("vehicle", "uav1", ["192.168.1.10", "UAV1.local", "fe80::0001"])
    names = certificate_of(team, "vehicle-uav1").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["uav1.local", "localhost"]
    addresses = ["192.168.1.10", "fe80::1", "127.0.0.1", "::1"]
    assert names.get_values_for_type(x509.IPAddress) == [ip_address(each) for each in addresses]


def test_only_the_owner_reads_private_keys_and_folders(team: Team) -> None:
    team.add("pilot", "ana")
    for path in (team.folder, *team.folder.rglob("*")):
        mode = stat.S_IMODE(path.stat().st_mode)
        if path.is_dir():
            assert mode == 0o700, path
        if path.name in ("key.pem", "mavlink.key"):
            assert mode == 0o600, path


def test_all_that_fly_by_mavlink_have_one_key_and_others_have_none(team: Team) -> None:
    for role in ROLES:
        team.add(role, "one")
    keys = {role: mavlink_key(str(team.bundle(f"{role}-one"))) for role in ROLES}
    assert len({keys["vehicle"], keys["ground"], keys["pilot"]}) == 1 and len(keys["pilot"]) == 32
    assert keys["rover"] == keys["viewer"] == mavlink_key(None) == b""


def test_a_bundle_from_before_there_was_a_mavlink_key_gets_it_when_it_is_renewed(team: Team) -> None:
    team.add("pilot", "ana")
    path = team.bundle("pilot-ana") / "mavlink.key"
    key = path.read_text()
    path.unlink()
    team.renew("pilot-ana")
    assert path.read_text() == key


def test_every_bundle_has_the_present_list_of_members(team: Team) -> None:
    team.add("vehicle", "uav1")
    team.add("pilot", "ana")
    team.add("pilot", "bo")
    team.revoke("pilot-ana")
    lists = [read_members(folder) for folder in (team.folder, team.bundle("vehicle-uav1"), team.bundle("pilot-bo"))]
    assert lists[0] == lists[1] == lists[2]
    assert lists[0].allowed("pilot") == ("pilot-bo",)
    assert lists[0].allowed("vehicle") == ("vehicle-uav1",)
    assert lists[0].is_revoked("pilot-ana") and not lists[0].is_revoked("pilot-bo")
    assert not lists[0].is_revoked("pilot-new")
    assert team.routers() == ["vehicle-uav1"]


def test_a_member_is_renewed_with_its_key_and_its_hosts_unless_others_are_given(team: Team) -> None:
    team.add("rover", "r1", ["10.0.0.2"], days=10)
    before, key = certificate_of(team, "rover-r1"), (team.bundle("rover-r1") / "key.pem").read_bytes()
    later = Team(team.folder, NOW + timedelta(days=9))
    later.renew("rover-r1")
    after = certificate_of(team, "rover-r1")
    assert after.public_key() == before.public_key()
    assert (team.bundle("rover-r1") / "key.pem").read_bytes() == key
    assert identity_of(after).expires == NOW + timedelta(days=9 + 365)
    assert identity_of(after).hosts == identity_of(before).hosts
    later.renew("rover-r1", ["10.0.0.3"])
    assert "10.0.0.3" in identity_of(certificate_of(team, "rover-r1")).hosts
    assert "10.0.0.2" not in identity_of(certificate_of(team, "rover-r1")).hosts
    member = later.members().find("rover-r1")
    assert member is not None and member.hosts == ("10.0.0.3",)


def test_a_certificate_ends_with_the_authority_which_then_signs_no_more(team: Team) -> None:
    end = team.authority_expires()
    late = Team(team.folder, end - timedelta(days=2))
    assert late.add("viewer", "late", days=100).expires == end
    with pytest.raises(KeysError, match="expired: make a new team"):
        Team(team.folder, end).add("viewer", "later")


def test_wrong_requests_are_refused_with_what_to_do(team: Team) -> None:
    team.add("pilot", "ana")
    team.revoke("pilot-ana")
    with pytest.raises(KeysError, match=r"revoked.*choose another name"):
        team.add("pilot", "ana")
    with pytest.raises(KeysError, match="revoked, for good"):
        team.renew("pilot-ana")
    team.add("pilot", "bo")
    with pytest.raises(KeysError, match="jezero keys renew pilot-bo"):
        team.add("pilot", "bo")
    with pytest.raises(KeysError, match="nobody connects to a viewer"):
        team.add("viewer", "x", ["10.0.0.1"])
    with pytest.raises(KeysError, match=r"no member 'bo'.*pilot-bo"):
        team.revoke("bo")
    with pytest.raises(KeysError, match="has a team already"):
        team.found()
    with pytest.raises(KeysError, match="jezero keys init"):
        Team(team.folder / "nowhere").members()


@pytest.mark.parametrize("name", ["", "a b", "a/b", "..", "uav1\n", "é", "a" * 33])
def test_a_name_that_no_key_or_folder_takes_is_refused(team: Team, name: str) -> None:
    with pytest.raises(KeysError, match="is no name of a member"):
        team.add("vehicle", name)


@pytest.mark.parametrize(
    "host", ["", "a b", "tcp/10.0.0.1", "10.0.0.1:7447", "10.0.0", "-a", "a..b", "uav1\n", "é.org"]
)
def test_what_is_no_host_is_refused(team: Team, host: str) -> None:
    with pytest.raises(KeysError, match="is no host"):
        team.add("vehicle", "uav1", [host])


def test_an_address_that_nobody_connects_to_is_refused(team: Team) -> None:
    with pytest.raises(KeysError, match=r"nobody connects to 0\.0\.0\.0"):
        team.add("vehicle", "uav1", ["0.0.0.0"])
    assert not team.bundle("vehicle-uav1").exists()


def test_a_damaged_list_is_named(team: Team) -> None:
    (team.folder / "members.json").write_text("{")
    with pytest.raises(KeysError, match=r"members.json is damaged"):
        team.add("pilot", "ana")


def test_a_damaged_authority_is_named(team: Team) -> None:
    (team.folder / "ca" / "certificate.pem").write_text("no certificate")
    with pytest.raises(KeysError, match=r"certificate.pem is damaged"):
        team.members()
