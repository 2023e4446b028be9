"""The members of a team: who has a certificate, and whose is revoked. Routers follow the list when it changes.

Zenoh reads no revocation lists of certificates. It knows members by the common names of their certificates, which its
access control compares letter by letter: so a name is allowed or not, and a revoked one is never given again.
"""

import re
from datetime import datetime
from pathlib import Path
from typing import Literal, get_args

import msgspec

from jezero.base.files import describe_os_error, write_whole
from jezero.keys.files import KeysError as KeysError  # noqa: PLC0414 - the name of this package's error for others
from jezero.keys.files import read_plain_file

Role = Literal["vehicle", "rover", "ground", "pilot", "viewer"]
ROLES: tuple[Role, ...] = get_args(Role)
HOST_ROLES: tuple[Role, ...] = ("vehicle", "rover", "ground")
"""Roles of computers that run a router: others connect to them."""
MEMBERS = "members.json"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")


class Member(msgspec.Struct, frozen=True, kw_only=True):
    """One computer or person of the team.

    Attributes:
        name: common name of the certificate, `<role>-<name>`.
        role: what the member may do.
        expires: end of the certificate's validity.
        hosts: names and IP addresses by which others reach the member's router.
        revoked: whether the member is no longer allowed.
    """

    name: str
    role: Role
    expires: datetime
    hosts: tuple[str, ...] = ()
    revoked: bool = False


class Members(msgspec.Struct, frozen=True, kw_only=True):
    """The list of members.

    Attributes:
        members: all that ever got a certificate, in the order of their names.
    """

    members: tuple[Member, ...] = ()

    def find(self, name: str) -> Member | None:
        """The member with a common name."""
        return next((member for member in self.members if member.name == name), None)

    def allowed(self, role: Role) -> tuple[str, ...]:
        """Common names of the members of a role that are not revoked, for Zenoh's access control."""
        return tuple(member.name for member in self.members if member.role == role and not member.revoked)

    def is_revoked(self, name: str) -> bool:
        """Whether a common name is revoked. A name that is not in the list isn't: it may be newer than the list."""
        member = self.find(name)
        return member is not None and member.revoked

    def with_member(self, member: Member) -> "Members":
        """The list with a member added or replaced."""
        others = [other for other in self.members if other.name != member.name]
        return Members(members=tuple(sorted((*others, member), key=lambda each: each.name)))


def common_name(role: Role, name: str) -> str:
    """The common name of a member's certificate: `vehicle-uav1`. A role has no `-`, so that it can be split again.

    Raises:
        KeysError: the name has other characters than letters, digits, `-` and `_`, or is longer than 32.
    """
    if not _NAME.fullmatch(name):
        raise KeysError(f"{name!r} is no name of a member: write 1 to 32 letters, digits, '-' and '_'")
    return f"{role}-{name}"


def read_members(folder: Path) -> Members:
    """Read the list in a bundle or in the team's folder.

    Raises:
        KeysError: the file is missing, unreadable or damaged.
    """
    path = folder / MEMBERS
    try:
        return msgspec.json.decode(read_plain_file(path), type=Members)
    except FileNotFoundError:
        raise KeysError(f"{path} is missing: copy the whole folder that `jezero keys add` wrote") from None
    except OSError as error:
        raise KeysError(describe_os_error(error)) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise KeysError(f"{path} is damaged ({error}): copy it anew from the computer that has the team") from None


def write_members(folder: Path, members: Members) -> None:
    """Write the list into a bundle or into the team's folder.

    Raises:
        OSError: it can't be written; the old list is still there.
    """
    write_whole(folder / MEMBERS, msgspec.json.format(msgspec.json.encode(members)) + b"\n")
