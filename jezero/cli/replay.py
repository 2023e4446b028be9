"""`jezero replay`: a recording on a bus again, with keys that pause and step, or through one of its services."""

import json
import re
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import click

from jezero.base.router_address import is_on_this_computer, shown_router
from jezero.cli.options import FINITE, RECORDING_PATH, check_times, vehicle_options
from jezero.cli.terminal import FAILED, REFUSED, UNREACHABLE, Keyboard
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    import zenoh

    from jezero.recording import Recording
    from jezero.replay.bus import ReplayBus
    from jezero.replay.errors import Errors
    from jezero.replay.player import Player
    from jezero.replay.through import Replay
    from jezero.runtime.service import Service

PLAIN = ("speed", "start_s", "end_s", "loop", "topics", "force", "vehicle", "router")
"""Parameters of a replay onto a bus, which mean nothing with --through."""
CONNECT_TIMEOUT_S = 1.0
LOOK_PERIOD_NS = 50_000_000
"""Period of reading the keyboard and drawing the progress while messages are due all the time."""
HEALTH_PERIOD_NS = NS_PER_S
RIGHT_ARROW = re.compile(r"\x1b[\[O]C")
ESCAPE_SEQUENCE = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]")
"""What a terminal sends for other keys than letters; a letter in it is none that somebody has pressed."""
KEYS = "space: pause, . or right arrow: step, q: quit"
OUTPUT_LENGTH_MAX = 300
"""Characters of an output that are shown."""


def _plain_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a replay onto a bus."""
    for option in (
        click.option("--force", is_flag=True, help="Replay where services run, too, without commands and clock."),
        click.option("--topic", "topics", multiple=True, help="Only this topic; may be given several times."),
        click.option("--loop", is_flag=True, help="Begin again at the end."),
        click.option("--to", "end_s", type=FINITE, metavar="S", help="End, in seconds from the start of FILE."),
        click.option("--from", "start_s", type=FINITE, default=0.0, metavar="S",
                     help="Start, in seconds from the start of FILE."),
        click.option("--speed", type=FINITE, default=1.0, show_default=True, metavar="K",
                     help="Seconds of the flight per second."),
    ):  # fmt: skip
        command = option(command)
    return command


@click.command()
@click.argument("file", type=RECORDING_PATH)
@_plain_options
@vehicle_options
@click.option("--through", "service", metavar="SERVICE", help="Publish nothing; run this service on what it received.")
@click.option("--class", "own", metavar="MODULE:CLASS", help="With --through: the class of a service of one's own.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="With --through: a setting that is to differ; may be given several times.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="With --through: print one JSON object.")
@click.pass_context
def replay(
    context: click.Context,
    /,
    file: Path,
    service: str | None,
    own: str | None,
    settings: tuple[str, ...],
    as_json: bool,
    **plain: Any,
) -> None:
    """Publish the messages of FILE as the services did when it was recorded, at the same times.

    Other programs see the flight again: `jezero watch`, `jezero status`, clients. Nothing flies: goals and requests are
    not sent. Without a router at its address, the replay is the router. In a terminal, space pauses and continues,
    `.` or the right arrow steps by a tenth of a second, q quits.

    FILE is a recording, or the folder of a run.
    """
    if service is not None:
        if given := [name for name in PLAIN if _is_given(context, name)]:
            option = next(each for each in context.command.params if each.name == given[0]).opts[0]
            raise click.UsageError(f"{option} has no meaning with --through, which publishes nothing")
        _replay_through(file, service, own, settings, as_json=as_json)
        return
    if own or settings or as_json:
        raise click.UsageError(f"{'--class' if own else '--set' if settings else '--json'} needs --through SERVICE")
    if not 0.001 <= plain["speed"] <= 1000.0:
        raise click.UsageError(f"--speed {plain['speed']:g}: give a number from 0.001 to 1000")
    check_times(plain["start_s"], plain["end_s"], "the replay")
    _replay_onto_bus(file, **plain)


def _is_given(context: click.Context, name: str) -> bool:
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def _replay_onto_bus(
    file: Path,
    *,
    speed: float,
    start_s: float,
    end_s: float | None,
    loop: bool,
    topics: Sequence[str],
    force: bool,
    vehicle: str,
    router: str,
) -> None:
    """Publish a recording's messages until its end, Ctrl+C or q.

    Args:
        file: the recording, or the folder of a run.
        speed: seconds of the flight per second.
        start_s: start, from the recording's first message.
        end_s: end, from the recording's first message; None for all.
        loop: begin again at the end.
        topics: topics to publish; none means all.
        force: replay on a bus where the vehicle's services run, too.
        vehicle: name of the vehicle whose keys are used.
        router: the router's address.

    Raises:
        ClickException: the recording, a topic or the range is wrong.
        SystemExit: the vehicle's services run on the bus, or there is no router.
    """
    from jezero.recording import RecordingError, open_recording

    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # gives the terminal back, as after Ctrl+C
    try:
        flight = _Flight(open_recording(file), speed, start_s, end_s, loop, topics)
        with _open_bus(router, vehicle) as bus:
            _Replay(flight, bus, vehicle, force).run()
    except RecordingError as error:
        raise click.ClickException(str(error)) from None
    except KeyboardInterrupt:
        return
    finally:
        signal.signal(signal.SIGTERM, before)


class _Flight:
    """The part of a recording that is replayed.

    Attributes:
        path: the recording.
        topics: topics that are published.
        start_ns: start of the part, from the recording's first message.
        end_ns: end of the part.

    Raises:
        RecordingError: the recording can't be read, or has no such topic or time.
    """

    def __init__(
        self,
        recording: "Recording",
        speed: float,
        start_s: float,
        end_s: float | None,
        loop: bool,
        topics: Sequence[str],
    ) -> None:
        from jezero.recording import RecordingError
        from jezero.replay.player import choose_topics

        summary = recording.summary()
        self.path = recording.path
        self.topics = choose_topics(self.path, summary.counts, topics)
        if start_s > summary.duration_s:
            raise RecordingError(f"{self.path} lasts {summary.duration_s:.1f} s: --from {start_s:g} is after its end")
        whole_ns = summary.end_ns - summary.start_ns
        self.start_ns = int(start_s * NS_PER_S)
        self.end_ns = whole_ns if end_s is None else min(int(end_s * NS_PER_S), whole_ns)
        self._speed, self._loop = speed, loop
        if self.player(self.topics).ended:
            raise RecordingError(f"{self.path} has no message of these topics in this time")
        if summary.problem:
            click.echo(f"warning: {self.path}: {summary.problem}; what can be read is replayed", err=True)

    def player(self, topics: Collection[str]) -> "Player":
        """Begin to play some of the topics now."""
        from jezero.replay.player import Player, replay_messages

        read = partial(replay_messages, self.path, topics, self.start_ns, self.end_ns)
        now_ns = time.monotonic_ns()
        return Player(read, self.start_ns, self.end_ns, now_ns, speed=self._speed, loop=self._loop)

    def in_words(self, at_ns: int) -> str:
        """The time in the flight, and the speed."""
        speed = "" if self._speed == 1.0 else f", {self._speed:g} times as fast"
        return f"{at_ns / NS_PER_S:.1f} s of {self.end_ns / NS_PER_S:.1f} s{speed}"


class _Bus(NamedTuple):
    """A bus on which a replay may publish.

    Attributes:
        session: session on it.
        router: address of its router, for people.
        is_own: whether this process is the router.
    """

    session: "zenoh.Session"
    router: str
    is_own: bool

    @property
    def connected(self) -> bool:
        """Whether the router is there now."""
        return self.is_own or bool(self.session.info.routers_zid())


@contextmanager
def _open_bus(router: str, vehicle: str) -> Iterator[_Bus]:
    """A session with the router, at its socket for services; without one here, this process is the router meanwhile.

    Args:
        vehicle: name of the vehicle within the keys.
    """
    import zenoh

    from jezero.base.zenoh_client import client_config
    from jezero.keys.diagnosis import connection_problem
    from jezero.runtime.instance import run_folder_of, socket_of
    from jezero.runtime.routing import ListenError, bus_of_router, open_router

    is_own = False
    try:
        session = zenoh.open(client_config(bus_of_router(router) or router, CONNECT_TIMEOUT_S))
    except zenoh.ZError:
        shown = shown_router(router)
        if problem := connection_problem(router):
            click.echo(f"unreachable: {problem}", err=True)
            raise SystemExit(UNREACHABLE) from None
        if not is_on_this_computer(router):
            click.echo(
                f"unreachable: no router at {shown}: start it, or give an address of this machine's loopback, such "
                "as tcp/127.0.0.1:7447, where the replay is the router",
                err=True,
            )
            raise SystemExit(UNREACHABLE) from None
        try:
            bus = socket_of(run_folder_of(vehicle))
            session = open_router(router, bus)
        except (ListenError, OSError) as error:
            raise click.ClickException(str(error)) from None
        is_own = True
        click.echo(f"no router at {shown}: the replay is the router until it ends, and on {bus} that for services")
    with session:
        yield _Bus(session, shown_router(router), is_own)


class _Replay:
    """One replay: the player, the bus and the terminal."""

    def __init__(self, flight: _Flight, bus: _Bus, vehicle: str, force: bool) -> None:
        self._flight = flight
        self._bus = bus
        self._vehicle = vehicle
        self._force = force
        self._quit = False
        self._health_due_ns = 0

    def run(self) -> None:
        """Play until the end, or until somebody ends it."""
        from jezero.replay.bus import ReplayBus, find_others
        from jezero.replay.player import COMMANDS

        topics, router = self._flight.topics, self._bus.router
        others = (
            "" if self._bus.is_own else find_others(self._bus.session, self._vehicle).in_words(self._vehicle, router)
        )
        if others:
            if not self._force:
                _refuse(others)
            topics = topics - COMMANDS
            if not topics:
                raise click.ClickException("nothing to replay: commands and clock are not published where services run")
            click.echo(f"warning: {others}: topics with two writers confuse their readers", err=True)
        with ReplayBus(self._bus.session, self._vehicle, topics) as bus, Keyboard() as keyboard:
            player = self._flight.player(topics)
            keys = f" ({KEYS})" if keyboard.attached else ""
            click.echo(
                f"replaying {self._flight.path} as {self._vehicle} on {router}: {len(topics)} topics{keys}. "
                "Ctrl+C ends it."
            )
            try:
                self._play(player, bus, keyboard)
            finally:
                at = self._flight.in_words(player.position_ns(time.monotonic_ns()))
                clear = "\r\x1b[K" if keyboard.attached else ""
                click.echo(f"{clear}ended at {at}: {bus.published} messages published")

    def _play(self, player: "Player", bus: "ReplayBus", keyboard: Keyboard) -> None:
        look_ns = 0
        while not (player.ended or self._quit):
            now_ns = time.monotonic_ns()
            if now_ns >= look_ns:
                look_ns = now_ns + LOOK_PERIOD_NS
                self._look(player, bus, keyboard, now_ns)
            elif (message := player.take(now_ns)) is not None:
                bus.publish(message)
            else:
                due_s, rest_s = player.wait_s(now_ns), (look_ns - now_ns) / NS_PER_S
                self._on_keys(keyboard.read(rest_s if due_s is None else min(due_s, rest_s)), player)

    def _look(self, player: "Player", bus: "ReplayBus", keyboard: Keyboard, now_ns: int) -> None:
        """Read the keyboard, publish health, draw the progress; end if the bus isn't the replay's any more."""
        self._on_keys(keyboard.read(0.0), player)
        at = self._flight.in_words(player.position_ns(now_ns)) + (", paused" if player.paused else "")
        if now_ns >= self._health_due_ns:
            self._health_due_ns = now_ns + HEALTH_PERIOD_NS
            bus.publish_health(f"replaying {self._flight.path}: {at}"[:1000])
            if not self._bus.connected:
                click.echo(f"unreachable: the connection to the router {self._bus.router} is lost", err=True)
                raise SystemExit(UNREACHABLE)
        if bus.started_services and not self._force:
            _refuse(f"{', '.join(bus.started_services)} of {self._vehicle} has started on {self._bus.router}")
        if keyboard.attached:
            width = shutil.get_terminal_size().columns - 1
            click.echo(f"\r\x1b[K{at}"[: width + 4], nl=False)

    def _on_keys(self, pressed: str, player: "Player") -> None:
        now_ns = time.monotonic_ns()
        for key in ESCAPE_SEQUENCE.sub("", RIGHT_ARROW.sub(".", pressed)):
            match key:
                case " " if player.paused:
                    player.resume(now_ns)
                case " ":
                    player.pause(now_ns)
                case ".":
                    player.step(now_ns)
                case "q" | "Q":
                    self._quit = True


def _refuse(reason: str) -> NoReturn:
    click.echo(
        f"refused: {reason}: replay as another vehicle with --vehicle or JEZERO_VEHICLE, on another router with "
        "--router or JEZERO_ROUTER, or all the same with --force",
        err=True,
    )
    raise SystemExit(REFUSED)


def _replay_through(file: Path, service: str, own: str | None, settings: Sequence[str], *, as_json: bool) -> None:
    """Replay a service, and print what has changed.

    Args:
        file: the recording, or the folder of a run.
        service: name of the service.
        own: class of a service of one's own, as `module:class`; None: jezero's.
        settings: changes, each `NAME=VALUE`.

    Raises:
        ClickException: the recording or a setting is wrong.
        Exit: the output is not the recorded one, although no setting was changed and the class is jezero's.
    """
    from rich.console import Console

    from jezero.recording import RecordingError, open_recording
    from jezero.replay.errors import relative_errors
    from jezero.replay.rebuild import SettingError
    from jezero.replay.through import replay_through

    changes = changed_settings(settings)
    try:
        with Console(stderr=True).status(f"replaying {service} …"), own_class(own) as made_from:
            replay = replay_through(open_recording(file).path, service, changes, made_from)
            errors = relative_errors(replay.published_before, replay.published, replay.files)
    except (RecordingError, SettingError) as error:
        raise click.ClickException(str(error)) from None
    if as_json:
        click.echo(json.dumps(_as_dict(replay, errors)))
    else:
        _print(replay, errors)
    if not (replay.identical or changes or own):
        raise click.exceptions.Exit(FAILED)


@contextmanager
def own_class(path: str | None) -> Iterator["type[Service] | None"]:
    """The class of the option `--class`, also of a file in this folder; what its code raises becomes a sentence.

    Raises:
        ClickException: it can't be replayed. The traceback of what its own code raised goes to standard error.
    """
    from jezero.replay.rebuild import OwnClassError, load_class

    sys.path.insert(0, str(Path.cwd()))
    try:
        yield None if path is None else load_class(path)
    except OwnClassError as error:
        if error.__cause__ is not None:
            traceback.print_exception(error.__cause__)
        raise click.ClickException(str(error)) from None
    finally:
        sys.path.remove(str(Path.cwd()))


def changed_settings(texts: Sequence[str]) -> dict[str, str]:
    """Settings and their values as TOML, from texts such as `std_uwb_m=0.05`.

    Raises:
        UsageError: a text is no such pair.
    """
    changes: dict[str, str] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise click.UsageError(f"--set {text}: give a setting and its value, such as --set std_uwb_m=0.05")
        changes[name] = value
    return changes


def _as_dict(replay: "Replay", errors: "tuple[Errors, Errors] | None") -> dict[str, Any]:
    import msgspec

    before, after = errors or (None, None)
    return {
        "service": replay.service,
        "files": [str(file) for file in replay.files],
        "identical": replay.identical,
        "first_difference": msgspec.to_builtins(replay.first_difference),
        "runs": replay.runs,
        "steps": replay.steps,
        "outputs": replay.outputs,
        "different_steps": replay.different,
        "gap_s": replay.gap_s,
        "lossy_images": replay.lossy_images,
        "not_received": replay.not_received,
        "errors_recorded": msgspec.to_builtins(before),
        "errors_replayed": msgspec.to_builtins(after),
    }


def _print(replay: "Replay", errors: "tuple[Errors, Errors] | None") -> None:
    runs = f"{replay.runs} run{'s' if replay.runs > 1 else ''}"
    click.echo(f"{replay.service}: {runs}, {replay.steps} steps, {replay.outputs} recorded outputs")
    if replay.gap_s is not None:
        click.echo(
            f"the replay ends {replay.gap_s:.1f} s from the start: from there on a part of the journal is missing"
        )
    if replay.lossy_images:
        click.echo(
            f"{replay.lossy_images} images are not exactly those that the service read: JPEG loses detail. For an "
            'exact replay, record with `images = "png"` in recorder.toml'
        )
    if replay.not_received:
        listed = ", ".join(replay.not_received)
        click.echo(f"never received: {listed}. A replay gives a service what the recorded one read, and nothing else")
    if replay.first_difference is None:
        click.echo("identical: all outputs are bit by bit the recorded ones")
    else:
        difference = replay.first_difference
        click.echo(f"different: the outputs of {replay.different} steps; the first at {difference.t_s:.3f} s")
        click.echo(f"  recorded  {_shown(difference.recorded)}")
        click.echo(f"  replayed  {_shown(difference.replayed)}")
    if replay.service == "estimator":
        _print_errors(errors)


def _print_errors(errors: "tuple[Errors, Errors] | None") -> None:
    if errors is None:
        click.echo("no errors: the recording has no truth, or no estimate is valid both as recorded and as replayed")
        return
    click.echo(
        f"error of the relative position against the truth, root mean square of the {errors[0].compared} estimates "
        "that are valid both as recorded and as replayed:"
    )
    for name, each in zip(("recorded", "replayed"), errors, strict=True):
        north_cm, east_cm, down_cm = (100.0 * rms_m for rms_m in each.rms_m)
        axes = f"north {north_cm:.1f}, east {east_cm:.1f}, down {down_cm:.1f}"
        valid = f"{each.valid} of {each.estimates} estimates are valid"
        click.echo(f"  {name}  {100.0 * each.rms_3d_m:5.1f} cm ({axes}); {valid}")


def _shown(output: str) -> str:
    if not output:
        return "nothing"
    return output if len(output) <= OUTPUT_LENGTH_MAX else f"{output[:OUTPUT_LENGTH_MAX]}…"
