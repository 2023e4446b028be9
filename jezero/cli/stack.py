"""`jezero up`, `down`, `ps` and `logs`: start, stop and show the stack."""

import contextlib
import os
import select
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import click

from jezero.base.extras import extra_hint
from jezero.base.files import NOT_UTF8, keep_private
from jezero.base.router_address import shown_router
from jezero.cli import completion
from jezero.cli.options import INSECURE, KEYS, Router, insecure_option, keys_option, world_option
from jezero.cli.terminal import FAILED, REFUSED, print_table
from jezero.keys.bundle import INSECURE_VARIABLE
from jezero.keys.bundle import VARIABLE as KEYS_VARIABLE

if TYPE_CHECKING:
    from jezero.deploy.launcher.compose import ComposeService
    from jezero.deploy.launcher.state import RunFolder, RunState
    from jezero.runtime.instance import HostLinks, Instance

POLL_S = 0.05
LAUNCHER_LOG = "launcher.log"
GROUND_STATION = "ground_station"
GATE_VARIABLE = "JEZERO_GATE"
"""Variable of the compose file: 1 where the stack has links with other computers."""
CAMERA_VARIABLE = "JEZERO_CAMERA"
"""Variable of the compose file: 1 where the settings name a real camera."""
NEEDS = {
    "camera_driver": "cv2",
    "simulator": "pybullet",
    "autopilot": "fastcrc",
    "vehicle_bridge": "pymavlink",
    "estimator": "scipy",
}
"""A package of the extra without which a service can't start."""
OPEN_FILES_MAX = 1 << 20
"""No process has a file descriptor with a greater number."""
KILL_LAUNCHER_AFTER_S = 30.0


def run_dir_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option for the folder of a run's state and logs."""
    return click.option(
        "--run-dir",
        envvar="JEZERO_RUN_DIR",
        type=click.Path(path_type=Path, file_okay=False),
        help="Folder of the run's state and logs [default: ~/.local/state/jezero/<vehicle>].",
    )(command)


def run_folder(run_dir: Path | None) -> "RunFolder":
    """The folder of that option, or the default one of the vehicle."""
    from jezero.deploy.launcher.state import RunFolder
    from jezero.runtime.instance import default_run_folder, vehicle_from_environment

    return RunFolder(run_dir or default_run_folder(vehicle_from_environment()))


@click.command()
@click.option(
    "--profile",
    "profiles",
    multiple=True,
    shell_complete=completion.profiles,
    help="Only this profile (sim, estimation, control, ground; onboard, rover); repeatable.",
)
@click.option("-d", "--detach", is_flag=True, help="Run in the background; `jezero down` stops it.")
@click.option("--wait", is_flag=True, help="Return when the vehicle is ready; implies -d.")
@click.option("--timeout", "timeout_s", type=click.FloatRange(min=0), default=60.0, show_default=True, metavar="S",
              help="Longest wait of --wait, in seconds.")  # fmt: skip
@click.option("-f", "--file", "file", type=click.Path(path_type=Path, dir_okay=False),
              help="Compose file [default: the one shipped with jezero].")  # fmt: skip
@click.option(
    "--listen", type=Router(), multiple=True, metavar="ADDRESS", help="Listen to other computers there; repeatable."
)
@click.option("--connect", type=Router(), multiple=True, metavar="ADDRESS", help="Connect to that router; repeatable.")
@world_option
@keys_option
@insecure_option("Listen and connect to other computers without TLS, on a network that you trust.")
@run_dir_option
@click.pass_context
def up(
    context: click.Context,
    /,
    profiles: tuple[str, ...],
    detach: bool,
    wait: bool,
    timeout_s: float,
    file: Path | None,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    run_dir: Path | None,
) -> None:
    """Start the services of the compose file as local processes, in the foreground unless -d.

    Ctrl+C stops them in reverse order; a second one kills them. No process is left, however the launcher ends.

    Programs of this computer reach them at JEZERO_ROUTER, and may do what a pilot may. The services meet at a socket in
    the run folder; a program that gets its address as JEZERO_ROUTER may do what services do.

    On several computers each runs its own part, with a router of its own:

    \b
    jezero up --profile onboard --listen tls/0.0.0.0:7448 --keys vehicle-uav1
    jezero up --profile ground --connect tls/192.168.1.10:7448 --keys ground-lab
    """
    from jezero.deploy.launcher.compose import shipped_compose_file
    from jezero.runtime.instance import instance_from_environment, links_from_environment

    start_s = time.monotonic()
    _set_environment(context, listen, connect)
    keep_private()
    instance, links, folder = instance_from_environment(), links_from_environment(), run_folder(run_dir)
    path = (file or shipped_compose_file()).resolve()
    services = _read_services(path, profiles, linked=any(links))
    try:
        with _sentences(folder):
            folder.acquire()
        if not (detach or wait):
            exit_now(_launch(services, folder, instance, links, path, detached=False))
        launcher = _detach(
            lambda: _launch(services, folder, instance, links, path, detached=True), keep=folder.fileno()
        )
        _wait_for_start(folder, launcher, start_s + timeout_s if wait else None, start_s)
        _warn_if_insecure(links)
    except _CannotStart as error:
        click.echo(f"Error: {error}", err=True)
        exit_now(error.exit_code)


def _set_environment(context: click.Context, listen: tuple[str, ...], connect: tuple[str, ...]) -> None:
    """Set the variables by which the services, and this process, know what the options say."""
    from jezero.runtime.instance import CONNECT_VARIABLE, LISTEN_VARIABLE

    if (keys := context.meta[KEYS]) is not None:
        os.environ[KEYS_VARIABLE] = str(keys.resolve())
    if context.meta[INSECURE]:
        os.environ[INSECURE_VARIABLE] = "1"
    for variable, endpoints in ((LISTEN_VARIABLE, listen), (CONNECT_VARIABLE, connect)):
        if endpoints:
            os.environ[variable] = " ".join(map(shown_router, endpoints))


def _read_services(path: Path, profiles: tuple[str, ...], *, linked: bool) -> "dict[str, ComposeService]":
    from jezero.base.plugins import plugin_names, refused_plugins
    from jezero.deploy.launcher.compose import ComposeError, parse, select, with_actions

    has_camera = "onboard" in profiles and "sim" not in profiles and _names_camera()
    variables = {GATE_VARIABLE: "1" if linked else "0", CAMERA_VARIABLE: "1" if has_camera else "0", **os.environ}
    try:
        services = select(with_actions(parse(path.read_text(encoding="utf-8"), variables), plugin_names()), profiles)
    except (ComposeError, OSError) as error:
        raise click.ClickException(f"{path}: {error.strerror if isinstance(error, OSError) else error}") from error
    except UnicodeDecodeError:
        raise click.ClickException(f"{path} {NOT_UTF8}") from None
    for refusal in refused_plugins().values():
        click.echo(f"no server for {refusal}", err=True)
    if refusal := _settings_refusal(has_autopilot="autopilot" in services):
        raise click.ClickException(refusal)
    if missing := [needed for name, needed in NEEDS.items() if name in services and not _is_installed(needed)]:
        raise click.ClickException(f"this command {extra_hint(*missing)}")
    if GROUND_STATION in services and not _is_installed("nicegui"):
        del services[GROUND_STATION]
        click.echo("no ground station in the browser, which is an extra: pip install 'jezero[ground]'", err=True)
    return services


def _settings_refusal(*, has_autopilot: bool) -> str:
    """Reason why the chosen autopilot can't fly in the chosen world, or ""; without settings too, which the launcher
    misses in words of its own.

    Raises:
        ConfigError: the settings that all services read are malformed, which each would say otherwise.
    """
    from jezero.base.config import chosen_autopilot, config_directory, load_config
    from jezero.base.vehicle_config import VehicleConfig, px4_refusal

    if not config_directory().is_dir():
        return ""
    vehicle = load_config(VehicleConfig, "vehicle")
    return px4_refusal(vehicle) if has_autopilot and chosen_autopilot() == "px4" else ""


def _is_installed(package: str) -> bool:
    return find_spec(package) is not None


def _names_camera() -> bool:
    """Whether the settings name a real camera.

    Raises:
        ConfigError: they are malformed.
    """
    from jezero.base.config import load_config
    from jezero.services.camera.config import CameraDriverConfig

    return bool(load_config(CameraDriverConfig, "camera_driver").source)


class _CannotStart(Exception):  # noqa: N818
    """The stack can't start; the message is one sentence.

    Attributes:
        exit_code: of the command.
    """

    def __init__(self, reason: str, exit_code: int) -> None:
        super().__init__(reason)
        self.exit_code = exit_code


@contextlib.contextmanager
def _sentences(folder: "RunFolder") -> Iterator[None]:
    """Turn each reason why a stack can't run in a folder into a `_CannotStart`."""
    from jezero.base.files import describe_os_error
    from jezero.deploy.launcher.state import AlreadyUpError, StartError

    try:
        yield
    except AlreadyUpError as error:
        raise _CannotStart(str(error), REFUSED) from None
    except StartError as error:
        raise _CannotStart(str(error), FAILED) from None
    except OSError as error:
        raise _CannotStart(f"the stack can't run in {folder.path}: {describe_os_error(error)}", FAILED) from None


def _launch(
    services: "dict[str, ComposeService]",
    folder: "RunFolder",
    instance: "Instance",
    links: "HostLinks",
    file: Path,
    *,
    detached: bool,
) -> int:
    """Run the launcher in this process; returns its exit code.

    Raises:
        _CannotStart: something is missing, or taken by another program; or the folder can't be written.
    """
    from jezero.deploy.launcher.compose import at_bus
    from jezero.deploy.launcher.launcher import Launcher
    from jezero.deploy.launcher.start_checks import ROUTER, Claims, check_start, find_bus
    from jezero.deploy.launcher.systemd import SystemdNotifier
    from jezero.services.vehicle_bridge.kept_fence import NAME as KEPT_FENCE

    with _sentences(folder), contextlib.closing(Claims()) as claims:
        (folder.path / KEPT_FENCE).unlink(missing_ok=True)  # a fence lasts until the stack ends
        if detached:
            _print_into(folder.logs / LAUNCHER_LOG)
        bus, router_runs = find_bus(services, instance, folder, claims)
        check_start(services, instance, bus, claims, router_runs=router_runs)
        _warn_if_insecure(links)
        services = at_bus(services, bus, str(folder.path), ROUTER)
        external = frozenset([ROUTER] if router_runs else [])
        terminal = None if detached else sys.stdout
        systemd = SystemdNotifier(os.environ)
        return Launcher(
            services, folder, instance, bus, str(file), external=external, terminal=terminal, systemd=systemd
        ).run()


def _warn_if_insecure(links: "HostLinks") -> None:
    from jezero.base.router_address import insecurity

    for endpoint in (*links.listen, *links.connect):
        if warning := insecurity(endpoint):
            click.echo(f"warning: {warning}", err=True)


def _print_into(log: Path) -> None:
    """Send what this process prints into a new file."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    for standard in (1, 2):
        os.dup2(descriptor, standard)
    os.close(descriptor)


def exit_now(code: int) -> NoReturn:
    """Exit without cleanup: Zenoh's threads may wait for a router that is gone."""
    with contextlib.suppress(OSError):  # the terminal is closed
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _detach(run: Callable[[], int], keep: int) -> TextIO:
    """Call `run` in a process with its own session that outlives this one.

    It closes every file that the caller has open, whose locks it would hold for as long as it runs.

    Args:
        keep: file descriptor that stays open.

    Returns:
        A file that ends when that process does. If `run` raises `_CannotStart`, it has the exit code and the reason.
    """
    reading, writing = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    if (middle := os.fork()) != 0:
        os.close(writing)
        code = os.waitstatus_to_exitcode(os.waitpid(middle, 0)[1])
        if code != 0:
            raise click.ClickException("the launcher could not be started: no new process")
        return open(reading, encoding="utf-8")
    try:
        os.setsid()
        if os.fork() != 0:
            os._exit(0)
    except OSError:
        os._exit(FAILED)
    null = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1, 2):
        os.dup2(null, standard)
    first, second = sorted((keep, writing))
    for begin, end in ((3, first), (first + 1, second), (second + 1, OPEN_FILES_MAX)):
        os.closerange(begin, end)
    try:
        code = run()
    except _CannotStart as error:
        os.write(writing, f"{error.exit_code} {error}".encode())
        code = error.exit_code
    exit_now(code)


def _wait_for_start(folder: "RunFolder", launcher: TextIO, deadline_s: float | None, start_s: float) -> None:
    """Wait until the launcher has started, or, with a deadline, until the vehicle is ready.

    Raises:
        _CannotStart: the launcher gave a reason and ended.
        click.ClickException: the launcher ended without one, a service failed, or the deadline passed.
    """
    shown = ""
    while True:
        ended = bool(select.select([launcher], [], [], 0)[0])  # before the state is read: it removes its state
        state = None if ended else folder.read()
        if ended:
            _raise_end(folder, launcher.read())
        if state is not None and deadline_s is None:
            click.echo(f"started; `jezero ps` shows the services. Run folder: {folder.path}{_recordings(folder)}")
            return
        if state is not None and state.ready:
            elapsed_s = time.monotonic() - start_s
            click.echo(f"ready after {elapsed_s:.1f} s. Run folder: {folder.path}{_recordings(folder)}")
            for line in state.addresses:
                click.echo(line)
            return
        if state is not None and state.failures:
            raise click.ClickException(f"{'; '.join(state.failures)}\n{_hint(folder)}")
        reason = "the launcher has not started" if state is None else state.not_ready_reason
        if deadline_s is not None and time.monotonic() > deadline_s:
            raise click.ClickException(f"not ready after {deadline_s - start_s:g} s: {reason}\n{_hint(folder)}")
        if reason != shown and sys.stderr.isatty():
            click.echo(f"waiting: {reason}", err=True)
            shown = reason
        select.select([launcher], [], [], POLL_S)


def _recordings(folder: "RunFolder") -> str:
    """The room that recordings take, which nothing deletes, or ""."""
    from jezero.recording.folder import RECORDINGS, room_bytes

    count, size_bytes = room_bytes(folder.path)
    return f"\n{count} recordings take {size_bytes / 1e6:.0f} MB in {folder.path / RECORDINGS}" if count > 1 else ""


def _raise_end(folder: "RunFolder", problem: str) -> NoReturn:
    """Report that the launcher ended.

    Args:
        problem: its exit code and the reason, or "".
    """
    code, _, reason = problem.partition(" ")
    if reason:
        raise _CannotStart(reason, int(code))
    log = ""
    with contextlib.suppress(OSError):
        log = (folder.logs / LAUNCHER_LOG).read_text(errors="replace").strip()
    raise click.ClickException(f"the launcher ended by itself: {log or 'it printed nothing'}")


def _hint(folder: "RunFolder") -> str:
    return f"`jezero logs` shows the services' output, `jezero down` stops the rest; run folder: {folder.path}"


@click.command()
@run_dir_option
def down(run_dir: Path | None) -> None:
    """Stop the services of `jezero up`, in reverse order. Without running services it succeeds too."""
    folder = run_folder(run_dir)
    state = folder.read()
    if state is None:
        click.echo(_nothing_runs(folder, "down"))
        return
    try:
        pidfd = os.pidfd_open(state.launcher_pid)
    except ProcessLookupError:
        click.echo("stopped")
        return
    if folder.read() is None:  # the launcher ended before pidfd_open, so the descriptor may be another process'
        click.echo("stopped")
        return
    signal.pidfd_send_signal(pidfd, signal.SIGTERM)
    if not select.select([pidfd], [], [], KILL_LAUNCHER_AFTER_S)[0]:
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)  # its services die with it
        select.select([pidfd], [], [], 1.0)
        click.echo(f"killed the launcher: it was still there after {KILL_LAUNCHER_AFTER_S:g} s", err=True)
        raise SystemExit(FAILED)
    click.echo("stopped")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array.")
@click.option(
    "--healthy",
    metavar="SERVICE",
    shell_complete=completion.services,
    help="Print nothing; exit with 0 if this service is healthy, by the bus.",
)
@run_dir_option
def ps(as_json: bool, healthy: str | None, run_dir: Path | None) -> None:
    """Show the state and health of the services."""
    if healthy is not None:
        exit_now(0 if _is_healthy(healthy) else FAILED)
    import msgspec

    folder = run_folder(run_dir)
    state = folder.read()
    if as_json:
        if state is None:
            click.echo(_nothing_runs(folder, "ps"), err=True)
        click.echo(msgspec.json.encode(state.services if state else []).decode())
    elif state is None:
        click.echo(_nothing_runs(folder, "ps"))
    else:
        _print_state(state)


def _nothing_runs(folder: "RunFolder", command: str) -> str:
    """The sentence for a folder without a stack, with a line for each stack of another folder.

    Args:
        command: what should be done there.
    """
    from jezero.deploy.launcher.state import running_stacks

    lines = [
        f"vehicle {state.vehicle} runs in {path}: `jezero {command} --run-dir {shlex.quote(str(path))}`"
        for path, state in running_stacks()
        if path != folder.path
    ]
    return "\n".join([f"nothing runs in {folder.path}", *lines])


def _is_healthy(service: str, timeout_s: float = 3.0) -> bool:
    """Whether a service reports healthy on the bus; works without a launcher too, as in a container."""
    import threading

    from jezero.deploy.launcher.health import HealthWatcher
    from jezero.runtime.instance import instance_from_environment

    changed = threading.Event()
    deadline_s = time.monotonic() + timeout_s
    with HealthWatcher(instance_from_environment(), changed.set) as watcher:
        while not watcher.report(service).healthy and time.monotonic() < deadline_s:
            changed.wait(deadline_s - time.monotonic())
            changed.clear()
        return watcher.report(service).healthy


def _print_state(state: "RunState") -> None:
    """Print a table, and whether the vehicle is ready."""
    rows = [("SERVICE", "STATE", "HEALTH", "PID", "UP", "RESTARTS", "")]
    for s in state.services:
        up_s = time.monotonic() - s.started_monotonic_s if s.pid and s.started_monotonic_s else None
        rows.append(
            (s.service, s.state, s.health, str(s.pid or ""), _span(up_s), str(s.restarts or ""), s.text.split("\n")[0])
        )
    print_table(rows)
    ready = "ready" if state.ready else f"not ready: {state.not_ready_reason}"
    click.echo(f"\nvehicle {state.vehicle} on {state.router}, launcher process {state.launcher_pid}: {ready}")
    for line in state.addresses:
        click.echo(line)


def _span(seconds: float | None) -> str:
    if seconds is None:
        return ""
    minutes, rest = divmod(int(seconds), 60)
    return f"{rest} s" if not minutes else f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h"


@click.command()
@click.argument("services", nargs=-1, metavar="[SERVICE]...", shell_complete=completion.services)
@click.option("-f", "--follow", is_flag=True, help="Continue with new lines until the stack stops.")
@click.option("-n", "--tail", type=click.IntRange(min=0), metavar="N", help="Only the last N lines.")
@click.option("-t", "--timestamps", is_flag=True, help="Show the time of each line (UTC).")
@run_dir_option
def logs(services: tuple[str, ...], follow: bool, tail: int | None, timestamps: bool, run_dir: Path | None) -> None:
    """Show the output of the services in the present or last run, in order of time."""
    from jezero.deploy.launcher.output import STAMP_LENGTH, LogReader, Prefixer

    folder = run_folder(run_dir)
    known = folder.logged()
    if unknown := [name for name in services if name not in known]:
        there = ", ".join(known) or "none"
        text = f"no log of {', '.join(unknown)} in {folder.logs}; there are: {there}"
        raise click.ClickException(text if folder.read() else f"{text}\n{_nothing_runs(folder, 'logs')}")
    if folder.read() is None:
        last = "; these are the logs of its last run" if known else ""
        first, *others = _nothing_runs(folder, "logs").splitlines()
        click.echo("\n".join([first + last, *others]), err=True)
    reader = LogReader(folder, services or known)
    prefixer = Prefixer(services or known, colour=sys.stdout.isatty())
    lines = reader.read()
    if tail is not None:
        lines = lines[len(lines) - min(tail, len(lines)) :]
    try:
        while True:
            running = folder.read() is not None  # before the read, so that the launcher's last lines are read too
            for name, line in lines:
                click.echo(prefixer.line(name, line if timestamps else line[STAMP_LENGTH + 1 :]))
            if not follow or not (running or lines):
                return
            time.sleep(0.0 if lines else 0.1)
            lines = reader.read()
    except KeyboardInterrupt:
        return
