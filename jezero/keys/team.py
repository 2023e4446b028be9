"""The folder of a team: its authority, its members, and a bundle for each of them.

team/ca/certificate.pem, team/ca/key.pem     the authority; its key stays on this computer
team/ca/mavlink.key                          for MAVLink's signatures; a copy is in the bundle of all that fly
team/members.json                            all members, also in each bundle
team/vehicle-uav1/                           a bundle, to be copied to the member's computer
"""

import os
import re
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from jezero.base.files import write_whole
from jezero.keys.authority import issue, issue_authority, new_key
from jezero.keys.bundle import (
    CA,
    CERTIFICATE,
    KEY,
    MAVLINK_KEY,
    MAVLINK_TEXT_LENGTH,
    check_private,
    read_certificate,
)
from jezero.keys.files import read_plain_file
from jezero.keys.members import (
    HOST_ROLES,
    KeysError,
    Member,
    Members,
    Role,
    common_name,
    read_members,
    write_members,
)

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey, EllipticCurvePublicKey

AUTHORITY = "ca"
MAVLINK_ROLES: tuple[Role, ...] = ("vehicle", "ground", "pilot")
"""Members that fly, or are flown, by MAVLink."""
DAYS = 365
_HOST_NAME = re.compile(r"(?=.{1,253}$)[A-Za-z0-9_]([A-Za-z0-9_-]{0,62})(\.[A-Za-z0-9_-]{1,63})*", re.ASCII)


def default_team() -> Path:
    """This user's folder: `~/.config/jezero/team`."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(base) / "jezero" / "team"


class Team:
    """A team, in its folder.

    Args:
        folder: the team's folder.
        now: present time, with a time zone; None reads the clock.

    Raises of all methods:
        KeysError: the request can't be fulfilled; the message says what to do.
        OSError: a file can't be read or written.
    """

    def __init__(self, folder: Path, now: datetime | None = None) -> None:
        self.folder = folder
        self._now = (now or datetime.now(UTC)).replace(microsecond=0)

    def found(self) -> datetime:
        """Make the authority; returns the end of its validity."""
        authority = self.folder / AUTHORITY
        if (authority / KEY).exists():
            raise KeysError(f"{self.folder} has a team already: choose another folder with --team")
        key = new_key()
        certificate = issue_authority(key, self._now)
        _make_private_folder(self.folder)
        _make_private_folder(authority)
        write_whole(authority / CERTIFICATE, _pem(certificate))
        write_members(self.folder, Members())
        _write_key(authority / KEY, key)
        return certificate.not_valid_after_utc

    def authority_expires(self) -> datetime:
        """End of the authority's validity."""
        return self._authority_certificate().not_valid_after_utc

    def members(self) -> Members:
        """All members."""
        self._authority_certificate()
        return read_members(self.folder)

    def bundle(self, name: str) -> Path:
        """Folder of a member's bundle."""
        return self.folder / name

    def add(self, role: Role, name: str, hosts: Sequence[str] = (), days: int = DAYS) -> Member:
        """Make a member and its bundle.

        Args:
            hosts: names and IP addresses by which others reach the member's router, for a role that has one.
            days: duration of its validity.
        """
        identity = common_name(role, name)
        members = self.members()
        known = members.find(identity)
        if known is not None and known.revoked:
            raise KeysError(f"{identity} is revoked, and routers know members by name: choose another name")
        if known is not None:
            raise KeysError(
                f"{identity} is a member already: `jezero keys renew {identity}` makes it a new certificate"
            )
        checked = _checked_hosts(role, hosts)
        key, bundle = new_key(), self.bundle(identity)
        certificate = self._issue(key.public_key(), role, identity, checked, days)
        _make_private_folder(bundle)
        _write_key(bundle / KEY, key)
        write_whole(bundle / CERTIFICATE, _pem(certificate))
        write_whole(bundle / CA, _pem(self._authority_certificate()))
        self._give_mavlink_key(role, bundle)
        return self._keep(
            members, Member(name=identity, role=role, expires=certificate.not_valid_after_utc, hosts=checked)
        )

    def renew(self, name: str, hosts: Sequence[str] = (), days: int = DAYS) -> Member:
        """Make a member a new certificate for the key that it has: only `certificate.pem` of its bundle changes.

        A bundle from before there were signatures of MAVLink gets the text for them too.

        Args:
            name: common name.
            hosts: as in `add`; none keeps those that it has.
            days: duration of its validity from now.
        """
        from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey

        members = self.members()
        member = self._known(members, name)
        if member.revoked:
            raise KeysError(f"{name} is revoked, for good: `jezero keys add {member.role} NAME` makes another member")
        checked = _checked_hosts(member.role, hosts) or member.hosts
        path = self.bundle(name) / CERTIFICATE
        if not path.exists():
            raise KeysError(f"{path} is missing: copy it back from the member's computer")
        public_key = read_certificate(path).public_key()
        assert isinstance(public_key, EllipticCurvePublicKey)
        certificate = self._issue(public_key, member.role, name, checked, days)
        write_whole(path, _pem(certificate))
        self._give_mavlink_key(member.role, path.parent)
        return self._keep(
            members, msgspec.structs.replace(member, expires=certificate.not_valid_after_utc, hosts=checked)
        )

    def revoke(self, name: str) -> Member:
        """Take a member out of the team, for good."""
        members = self.members()
        return self._keep(members, msgspec.structs.replace(self._known(members, name), revoked=True))

    def routers(self) -> list[str]:
        """Members whose computers have a router, and so need the present list of members."""
        members = self.members()
        return [name for role in HOST_ROLES for name in members.allowed(role)]

    def _keep(self, members: Members, member: Member) -> Member:
        """Write the list of members with this one, into the team's folder and into each bundle that is still here."""
        changed = members.with_member(member)
        write_members(self.folder, changed)
        for each in changed.members:
            if self.bundle(each.name).is_dir():
                write_members(self.bundle(each.name), changed)
        return member

    def _give_mavlink_key(self, role: Role, bundle: Path) -> None:
        """Copy the text for MAVLink's signatures into a bundle; the first that needs it makes it."""
        if role not in MAVLINK_ROLES:
            return
        made = self.folder / AUTHORITY / MAVLINK_KEY
        if not made.exists():
            _write_private(made, f"{secrets.token_hex(MAVLINK_TEXT_LENGTH // 2)}\n".encode())
        _write_private(bundle / MAVLINK_KEY, read_plain_file(made))

    def _known(self, members: Members, name: str) -> Member:
        member = members.find(name)
        if member is None:
            names = ", ".join(each.name for each in members.members) or "none yet"
            raise KeysError(f"no member {name!r}: `jezero keys list` shows them ({names})")
        return member

    def _issue(
        self, public_key: "EllipticCurvePublicKey", role: Role, name: str, hosts: Sequence[str], days: int
    ) -> "x509.Certificate":
        from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        certificate = self._authority_certificate()
        if certificate.not_valid_after_utc <= self._now:
            raise KeysError(
                f"the authority in {self.folder} has expired: make a new team in another folder with --team, "
                "and new bundles for all members"
            )
        check_private(self.folder / AUTHORITY)
        key = load_pem_private_key(read_plain_file(self.folder / AUTHORITY / KEY), password=None)
        assert isinstance(key, EllipticCurvePrivateKey)
        validity = (self._now, self._now + timedelta(days=days))
        return issue(public_key, role, name, hosts, validity, (certificate, key))

    def _authority_certificate(self) -> "x509.Certificate":
        path = self.folder / AUTHORITY / CERTIFICATE
        if not path.exists():
            raise KeysError(f"{self.folder} has no team: `jezero keys init` makes one, --team names another folder")
        return read_certificate(path)


def _checked_hosts(role: Role, hosts: Sequence[str]) -> tuple[str, ...]:
    """The addresses of a member as its certificate has them.

    Raises:
        KeysError: one is wrong, or nobody connects to such a member.
    """
    if hosts and role not in HOST_ROLES:
        raise KeysError(f"--host is for {', '.join(HOST_ROLES)}: nobody connects to a {role}")
    return tuple(_checked_host(host) for host in hosts)


def _checked_host(host: str) -> str:
    """A host's name or IP address as a certificate has it.

    Raises:
        KeysError: it is neither.
    """
    try:
        address = ip_address(host)
    except ValueError:
        if _HOST_NAME.fullmatch(host) and not re.fullmatch(r"[\d.]+", host):
            return host.lower()
        raise KeysError(
            f"{host!r} is no host: write a name or an IP address alone, such as 192.168.1.10 or uav1.local"
        ) from None
    if address.is_unspecified:
        raise KeysError(f"nobody connects to {host}: give the address by which others reach this computer")
    return str(address)


def _make_private_folder(folder: Path) -> None:
    """Make a folder that only its owner reads."""
    folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)


def _write_key(path: Path, key: "EllipticCurvePrivateKey") -> None:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    _write_private(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))


def _write_private(path: Path, data: bytes) -> None:
    """Write a file that only its owner reads, also while it is written."""
    path.unlink(missing_ok=True)
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(data)


def _pem(certificate: "x509.Certificate") -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding

    return certificate.public_bytes(Encoding.PEM)
