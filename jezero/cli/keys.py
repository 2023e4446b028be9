"""`jezero keys`: the certificates with which a team's computers and people speak TLS with each other."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.options import CommandGroup
from jezero.cli.terminal import print_table
from jezero.keys.members import HOST_ROLES, MEMBERS, ROLES, KeysError, Member, Role

if TYPE_CHECKING:
    from jezero.keys.team import Team

EXPIRES_SOON_DAYS = 30


def team_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option for the team's folder."""
    return click.option(
        "--team",
        type=click.Path(path_type=Path, file_okay=False),
        help="Folder of the team [default: ~/.config/jezero/team].",
    )(command)


def validity_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a new certificate."""
    command = click.option(
        "--days",
        type=click.IntRange(1, 3650),
        default=365,
        show_default=True,
        help="Duration for which the certificate is valid.",
    )(command)
    return click.option(
        "--host",
        "hosts",
        multiple=True,
        metavar="ADDRESS",
        help="Name or IP address by which others reach this computer's router; repeatable.",
    )(command)


@contextmanager
def _opened(folder: Path | None) -> Iterator["Team"]:
    """The team of a command; what is wrong with it becomes a sentence."""
    from jezero.keys.team import Team, default_team

    try:
        yield Team((folder or default_team()).expanduser())
    except KeysError as error:
        raise click.ClickException(str(error)) from None


@click.group(cls=CommandGroup)
def keys() -> None:
    """Make, renew and revoke the certificates of a team's computers and people.

    The team's folder holds the key of its authority, and stays on one computer. Each member gets a bundle, a folder to
    copy.
    """


@keys.command()
@team_option
def init(team: Path | None) -> None:
    """Make the authority of a new team."""
    with _opened(team) as opened:
        expires = opened.found()
        click.echo(
            f"the team is in {opened.folder}, its authority is valid until {expires:%Y-%m-%d}. "
            "Whoever reads this folder can make keys: keep it on one computer"
        )


@keys.command()
@click.argument("role", type=click.Choice(ROLES))
@click.argument("name")
@validity_options
@team_option
def add(role: Role, name: str, hosts: tuple[str, ...], days: int, team: Path | None) -> None:
    """Make the bundle of a new member.

    ROLE is vehicle, rover or ground for a computer with a router; pilot for a person who flies, viewer for one who
    only watches. The member's name is ROLE-NAME.
    """
    with _opened(team) as opened:
        member = opened.add(role, name, hosts, days)
        click.echo(f"{member.name} is valid until {member.expires:%Y-%m-%d}{_reached(member)}")
        click.echo(f"copy the folder to its computer, over a safe way: {opened.bundle(member.name)}")
        _tell_routers(opened, but=member.name)


@keys.command()
@click.argument("name")
@validity_options
@team_option
def renew(name: str, hosts: tuple[str, ...], days: int, team: Path | None) -> None:
    """Make a member a new certificate, for instance with other addresses. NAME is that of `jezero keys list`.

    Its private key stays, so that one file is to be copied. Without --host the addresses stay too.
    """
    with _opened(team) as opened:
        member = opened.renew(name, hosts, days)
        click.echo(f"{member.name} is valid until {member.expires:%Y-%m-%d}{_reached(member)}")
        click.echo(f"copy the file into the bundle on its computer: {opened.bundle(name) / 'certificate.pem'}")


@keys.command()
@click.argument("name")
@team_option
def revoke(name: str, team: Path | None) -> None:
    """Take a member out of the team, for good. NAME is that of `jezero keys list`."""
    with _opened(team) as opened:
        member = opened.revoke(name)
        click.echo(f"{member.name} is revoked")
        _tell_routers(opened)


@keys.command(name="list")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@team_option
def list_(as_json: bool, team: Path | None) -> None:
    """Show the members, and when they expire."""
    import msgspec

    with _opened(team) as opened:
        members, expires = opened.members().members, opened.authority_expires()
        if as_json:
            click.echo(msgspec.json.encode({"authority_expires": expires, "members": members}).decode())
            return
        now = datetime.now(UTC)
        rows = [("name", "role", "valid until", "addresses"), ("authority", "", _expiry(expires, now), "")]
        rows += [
            (
                member.name,
                member.role,
                "revoked" if member.revoked else _expiry(member.expires, now),
                ", ".join(member.hosts),
            )
            for member in members
        ]
        print_table(rows)


def _expiry(expires: datetime, now: datetime) -> str:
    """The end of a validity, with a word where it is over or near."""
    days = (expires - now).days
    word = ", expired" if expires <= now else f", in {days} days" if days < EXPIRES_SOON_DAYS else ""
    return f"{expires:%Y-%m-%d}{word}"


def _reached(member: Member) -> str:
    """For a computer with a router: how others reach it."""
    if member.role not in HOST_ROLES:
        return ""
    if not member.hosts:
        return "; without --host others can't connect to it, it can only connect to them"
    return f"; others connect to it as {' or '.join(member.hosts)}"


def _tell_routers(team: "Team", but: str = "") -> None:
    """Print which computers must get the changed list of members."""
    others = [name for name in team.routers() if name != but]
    if others:
        click.echo(
            f"the list of members has changed: copy {team.folder / MEMBERS} into the bundles of {', '.join(others)}, "
            "whose routers follow it by themselves, also in flight"
        )
