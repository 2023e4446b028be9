"""`jezero replay`: the messages of a recording on a bus again, with keys that pause and step."""

import re
import shutil
import signal
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import click

from jezero.cli.exit_codes import REFUSED, UNREACHABLE
from jezero.cli.keyboard import Keyboard
from jezero.router_address import is_on_this_computer, shown_router
from jezero.schemas.units import NS_PER_S

if TYPE_CHECKING:
    import zenoh

    from jezero.recording import Recording
    from jezero.replay.bus import ReplayBus
    from jezero.replay.player import Player

CONNECT_TIMEOUT_S = 1.0
LOOK_PERIOD_NS = 50_000_000
"""Period of reading the keyboard and drawing the progress while messages are due all the time."""
HEALTH_PERIOD_NS = NS_PER_S
RIGHT_ARROW = re.compile(r"\x1b[\[O]C")
ESCAPE_SEQUENCE = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]")
"""What a terminal sends for other keys than letters; a letter in it is none that somebody has pressed."""
KEYS = "space: pause, . or right arrow: step, q: quit"


def replay_onto_bus(
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

    from jezero.keys.diagnosis import connection_problem
    from jezero.runtime.bus_address import bus_of_router, run_folder_of, socket_of
    from jezero.runtime.routing import ListenError, open_router
    from jezero.zenoh_client import client_config

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
