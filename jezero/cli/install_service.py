"""`jezero install-service`: write the systemd unit that starts a stack at boot, or remove it."""

import grp
import os
import pwd
import shlex
import subprocess
import sys
from pathlib import Path

import click

from jezero.cli import completion
from jezero.cli.terminal import REFUSED

UNITS = Path("/etc/systemd/system")
SYSTEMD = Path("/run/systemd/system")
"""Folder that exists while systemd runs the computer. Source: sd_booted(3)."""
GROUPS = ("dialout", "video")
"""Groups whose members may open serial lines and cameras."""
PATHS = ("JEZERO_CONFIG_DIR", "JEZERO_KEYS", "JEZERO_PX4_DIR")
"""Variables with a path, which systemd would read from another folder than this one."""


class InstallError(click.ClickException):
    """The unit can't be written; the message says why and what to do."""

    exit_code = REFUSED


@click.command()
@click.option("--profile", "profiles", multiple=True, required=True, shell_complete=completion.profiles,
              help="What `jezero up` runs there: onboard, rover, ground, ...; repeatable.")  # fmt: skip
@click.option("--user", default="", metavar="NAME",
              help="User of the services, not root [default: you, or who has called sudo].")  # fmt: skip
@click.option("--run-folder", type=click.Path(path_type=Path), metavar="DIR",
              help="Run folder, which that user can write [default: /var/lib/jezero-PROFILE].")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False, exists=True), metavar="DIR",
              help=f"Folder of the unit, to look at it or for another computer [default: {UNITS}].")  # fmt: skip
@click.option("--remove", is_flag=True, help="Stop the service and remove its unit.")
def install_service(
    profiles: tuple[str, ...], user: str, run_folder: Path | None, out: Path | None, remove: bool
) -> None:
    """Write a systemd unit that starts `jezero up --profile NAME` at boot.

    One unit runs the launcher, which supervises all services. The variables JEZERO_... that are set now are written
    into it. systemd starts the launcher again when it fails or freezes.
    """
    from jezero.deploy.service_unit import unit_name, unit_text

    _check_profiles(profiles)
    _check_systemd(out)
    path = (out or UNITS) / unit_name(profiles)
    if remove:
        _remove(path, out)
        return
    user = user or os.environ.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    account = _account(user)
    folder = None if run_folder is None else _checked_folder(run_folder, account)
    environment = _stack_environment()
    command = [sys.executable, "-m", "jezero.cli.main", "up", *(w for name in profiles for w in ("--profile", name))]
    groups = [name for name in GROUPS if _group_exists(name)]
    text = unit_text(profiles, command, user, groups, environment, folder)
    if out is None and not os.access(UNITS, os.W_OK):
        raise InstallError(f"only root may write into {UNITS}. Run:\n  {_with_sudo(environment, user)}")
    if out is None and (closed := _closed_folder(Path(sys.executable), account)):
        raise InstallError(
            f"{user} can't start {sys.executable}, as {closed} is closed to others: install jezero outside of it, such "
            "as in /opt"
        )
    path.write_text(text, encoding="utf-8")
    path.chmod(0o644)
    if missing := sorted(set(GROUPS) - set(groups)):
        click.echo(f"this computer has no group {' and no '.join(missing)}: add the groups of its devices to {path}")
    click.echo(f"wrote {path}")
    if out is None:
        _systemctl("daemon-reload")
        click.echo(f"start it now and at each boot: sudo systemctl enable --now {path.name}")
        click.echo(f"see it: systemctl status {path.name}, and as {user} jezero ps")
    else:
        click.echo(f"install it: sudo cp {shlex.quote(str(path))} {UNITS} && sudo systemctl enable --now {path.name}")


def _check_profiles(profiles: tuple[str, ...]) -> None:
    known = completion.profiles(click.get_current_context(), click.Option(["--profile"]), "")
    for name in profiles:
        if name not in known:
            raise click.BadParameter(
                f"there is no profile {name!r}; there are {', '.join(known)}", param_hint="--profile"
            )


def _check_systemd(out: Path | None) -> None:
    """Refuse to install where nothing would start the unit."""
    if sys.platform != "linux":
        raise InstallError("systemd runs on Linux only; write the unit for a Linux computer with --out DIR")
    if out is None and not SYSTEMD.is_dir():
        raise InstallError(
            "systemd does not run this computer, as in a container: start `jezero up` there, or write the unit for "
            "another computer with --out DIR"
        )


def _account(user: str) -> pwd.struct_passwd:
    try:
        account = pwd.getpwnam(user)
    except KeyError:
        raise InstallError(
            f"there is no user {user!r} on this computer: sudo useradd --system {shlex.quote(user)}"
        ) from None
    if account.pw_uid == 0:
        raise InstallError("the services don't run as root, who may do everything: name another user with --user NAME")
    return account


def _checked_folder(folder: Path, account: pwd.struct_passwd) -> Path:
    """The whole path of a run folder."""
    from jezero.runtime.instance import PREFIX, SOCKET, socket_of

    folder = folder.resolve()
    name, group = account.pw_name, grp.getgrgid(account.pw_gid).gr_name
    if not folder.is_dir():
        make = shlex.join(["sudo", "install", "-d", "-m", "0700", "-o", name, "-g", group, str(folder)])
        raise InstallError(f"there is no run folder {folder}; make it with {make}")
    if not _may(0o3, folder, account):
        raise InstallError(
            f"{name} can't write into the run folder {folder}: choose a folder of {name}, or leave the option out"
        )
    if socket_of(folder) != f"{PREFIX}{folder / SOCKET}":
        raise InstallError(f"{folder} is too long for the path of a socket, or has unusual characters: choose another")
    return folder


def _closed_folder(program: Path, account: pwd.struct_passwd) -> Path | None:
    """The first folder on the way to a program, or to what it is a link to, that a user may not enter."""
    folders = (*reversed(program.parents), *reversed(program.resolve().parents))
    return next((folder for folder in folders if not _may(0o1, folder, account)), None)


def _may(wanted: int, folder: Path, account: pwd.struct_passwd) -> bool:
    """Whether a user has all these permissions (1 enter, 2 write) for a folder, by its owner, group and mode."""
    state = folder.stat()
    if state.st_uid == account.pw_uid:
        shift = 6
    elif state.st_gid in os.getgrouplist(account.pw_name, account.pw_gid):
        shift = 3
    else:
        shift = 0
    return state.st_mode >> shift & wanted == wanted


def _stack_environment() -> dict[str, str]:
    """The variables of the stack that are set now, with whole paths."""
    return {
        name: str(Path(value).resolve()) if name in PATHS else value
        for name, value in sorted(os.environ.items())
        if name.startswith("JEZERO_") and value and name != "JEZERO_RUN_DIR"
    }


def _group_exists(name: str) -> bool:
    try:
        grp.getgrnam(name)
    except KeyError:
        return False
    return True


def _with_sudo(environment: dict[str, str], user: str) -> str:
    """This command for root, who has another environment."""
    words = [a for a in sys.argv[1:] if a]
    named = [] if "--user" in words else ["--user", user]
    variables = [f"{name}={value}" for name, value in environment.items()]
    program = Path(sys.argv[0]).resolve()
    command = [str(program)] if os.access(program, os.X_OK) else [sys.executable, "-m", "jezero.cli.main"]
    return shlex.join(["sudo", *variables, *command, *words, *named])


def _remove(path: Path, out: Path | None) -> None:
    if not path.exists():
        click.echo(f"there is no {path}")
        return
    if not os.access(path.parent, os.W_OK):
        raise InstallError(f"only root may write into {path.parent}. Run:\n  {shlex.join(['sudo', *sys.argv])}")
    if out is None:
        _systemctl("disable", "--now", path.name)
    path.unlink()
    if out is None:
        _systemctl("daemon-reload")
    click.echo(f"removed {path}; the run folder stays, with its recordings")


def _systemctl(*words: str) -> None:
    done = subprocess.run(["systemctl", *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise click.ClickException(f"systemctl {shlex.join(words)}: {done.stderr.strip()}")
