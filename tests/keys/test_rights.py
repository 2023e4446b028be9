"""What each program may do on a router, tried with real sessions: every key, every role, every operation.

Members of the team are on other computers, behind the gate by TLS. On the vehicle's computer a service is one that
comes by the socket, and a program of people one that comes by TCP.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import pytest
import zenoh

from jezero import Refused, Unreachable, Vehicle
from jezero.base.zenoh_client import client_config
from jezero.client.session import Connection
from jezero.keys.bundle import secured
from jezero.keys.members import MEMBERS as MEMBERS_FILE
from jezero.keys.members import Role
from jezero.keys.rights import may_send
from jezero.keys.team import Team
from jezero.runtime.instance import HostLinks, socket_of
from jezero.runtime.routing import ListenError, open_gate, open_router
from jezero.schemas.commands import RoverCommand
from jezero.schemas.rows import CLIENTS, Endpoint, Topic
from jezero.schemas.state import Clock
from jezero.schemas.topics import (
    CLOCK,
    ENDPOINTS,
    ROVER_COMMAND,
    TOPICS,
    health_of,
    journal_of,
    key,
    liveliness_key,
)
from tests.keys.rig import free_port, make_team

pytestmark = pytest.mark.process

VEHICLE = "uav1"
SETTLE_S = 0.5
"""Time in which what is allowed has long arrived."""
BLOCK = zenoh.CongestionControl.BLOCK
Who = Role | Literal["program", "service"]
"""A role of the team on another computer, or a program or service of the vehicle's own."""
MEMBERS: dict[Role, str] = {
    "viewer": "viewer-eye",
    "pilot": "pilot-ana",
    "ground": "ground-lab",
    "rover": "rover-r1",
    "vehicle": "vehicle-uav1",
}
EVERYBODY: tuple[Who, ...] = (*MEMBERS, "program", "service")
PILOTS: frozenset[Who] = frozenset({"pilot", "ground", "program"})
SERVICES: frozenset[Who] = frozenset({"vehicle", "service"})
ALL_TOPICS: list[Topic[Any]] = [*TOPICS, health_of("estimator"), journal_of("estimator")]
PLANES = ("", "@action/", "@control/", "@estimator/", "@fence/", "@mission/", "@preflight/", "@simulator/")


def name_of(endpoint: Endpoint[Any, Any]) -> str:
    """A key to which requests are sent; for a pattern one that it matches."""
    return endpoint.name.replace("**", "somersault")


ASKED = {name_of(endpoint): endpoint for endpoint in ENDPOINTS}
TOKENS = {
    ("client", "py-1"): {*PILOTS, "rover", *SERVICES},
    ("service", "rover"): {"rover", *SERVICES},
    ("service", "rover_driver"): {"rover", *SERVICES},
    ("service", "estimator"): SERVICES,
}
"""Kind and name of liveliness tokens, and who may declare them."""


def publishers_of(topic: Topic[Any]) -> set[Who]:
    """Who may publish on a topic, by its row in the table."""
    allowed: set[Who] = set(SERVICES)
    if topic.host == "rover":
        allowed.add("rover")
    if topic.writer == CLIENTS:
        allowed |= PILOTS
    return allowed


def askers_of(endpoint: Endpoint[Any, Any]) -> set[Who]:
    """Who may send requests to an endpoint, by its row in the table."""
    allowed: dict[str, set[Who]] = {"viewer": set(EVERYBODY), "pilot": {*PILOTS, *SERVICES}, "service": set(SERVICES)}
    return allowed[endpoint.asker]


@dataclass
class Bus:
    """The two routers of a vehicle's computer, and a session with them of everybody.

    Attributes:
        inside: session of one of the vehicle's own services.
        sessions: the session of each that tries.
    """

    inside: zenoh.Session
    sessions: dict[Who, zenoh.Session]


@contextmanager
def computer(bundle: Path, run_folder: Path) -> Iterator[tuple[int, str, str]]:
    """The routers of a vehicle's computer.

    Returns:
        Port of the gate, and the addresses for programs and for services.
    """
    port, people, bus = free_port(), f"tcp/127.0.0.1:{free_port()}", socket_of(run_folder)
    links = HostLinks(listen=(secured(f"tls/0.0.0.0:{port}", bundle),))
    with open_router(people, bus), open_gate(bus, VEHICLE, links):
        yield port, people, bus


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bus]:
    team = make_team(tmp_path_factory.mktemp("team"))
    team.add("rover", "r1")
    with (
        computer(team.bundle("vehicle-uav1"), tmp_path_factory.mktemp("run")) as (port, people, socket),
        ExitStack() as ends,
    ):

        def connect(endpoint: str) -> zenoh.Session:
            return ends.enter_context(zenoh.open(client_config(endpoint, 3.0)))

        yield Bus(
            connect(socket),
            {
                **{
                    role: connect(secured(f"tls/127.0.0.1:{port}", team.bundle(name))) for role, name in MEMBERS.items()
                },
                "program": connect(people),
                "service": connect(socket),
            },
        )


class Heard:
    """What a session receives, by who has sent it; a context manager.

    Attributes:
        keys: without the vehicle's prefix.
    """

    def __init__(self, session: zenoh.Session, names: list[str]) -> None:
        self.keys: dict[str, set[str]] = {who: set() for who in EVERYBODY}
        self._session = session
        self._names = names
        self._ends = ExitStack()

    def __enter__(self) -> Self:
        for name in self._names:
            subscriber = self._session.declare_subscriber(key(VEHICLE, name), self._on_sample)
            self._ends.callback(subscriber.undeclare)
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.close()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        sender = "unknown" if sample.attachment is None else sample.attachment.to_string()
        self.keys.setdefault(sender, set()).add(short(sample.key_expr))


def short(name: object) -> str:
    return str(name).removeprefix(key(VEHICLE, ""))


def test_each_topic_is_published_by_its_writers_alone(bus: Bus) -> None:
    names = [topic.name for topic in ALL_TOPICS] + list(ASKED)
    with Heard(bus.inside, [f"{plane}**" for plane in PLANES]) as heard:
        time.sleep(SETTLE_S)
        for who, session in bus.sessions.items():
            for name in names:
                session.put(key(VEHICLE, name), "x", attachment=who, congestion_control=BLOCK)
        time.sleep(SETTLE_S)
    assert heard.keys == {
        who: set(names) if who in SERVICES else {topic.name for topic in ALL_TOPICS if who in publishers_of(topic)}
        for who in EVERYBODY
    }


def test_nobody_but_services_deletes(bus: Bus) -> None:
    names = [topic.name for topic in ALL_TOPICS] + list(ASKED)
    with Heard(bus.inside, [f"{plane}**" for plane in PLANES]) as heard:
        time.sleep(SETTLE_S)
        for who, session in bus.sessions.items():
            for name in names:
                session.delete(key(VEHICLE, name), attachment=who, congestion_control=BLOCK)
        time.sleep(SETTLE_S)
    assert heard.keys == {who: set(names) if who in SERVICES else set() for who in EVERYBODY}


@pytest.mark.parametrize("wildcards", [False, True], ids=["by their keys", "by wildcards"])
def test_everybody_reads_each_topic_that_crosses_the_link(bus: Bus, wildcards: bool) -> None:
    names = [topic.name for topic in ALL_TOPICS]
    at_home = {topic.name for topic in ALL_TOPICS if topic.link_hz == 0.0}
    with ExitStack() as ends:
        readers = {
            who: ends.enter_context(Heard(session, ["**"] if wildcards else names))
            for who, session in bus.sessions.items()
        }
        time.sleep(SETTLE_S)
        for name in names:
            bus.inside.put(key(VEHICLE, name), "x", attachment="service", congestion_control=BLOCK)
        time.sleep(SETTLE_S)
    assert {who: heard.keys["service"] for who, heard in readers.items()} == {
        who: set(names) if who in ("program", "service") else set(names) - at_home for who in EVERYBODY
    }


def test_each_endpoint_is_asked_by_its_askers_alone(bus: Bus) -> None:
    asked: dict[str, set[str]] = {}
    replied: dict[Who, set[str]] = {}
    with ExitStack() as ends:
        for name in ASKED:
            reply = answering(asked)
            ends.callback(bus.inside.declare_queryable(key(VEHICLE, name), reply, complete=True).undeclare)
        time.sleep(SETTLE_S)
        for who, session in bus.sessions.items():
            replied[who] = {name for name in ASKED if replies(session, name, who)}
    allowed = {who: {name for name, each in ASKED.items() if who in askers_of(each)} for who in EVERYBODY}
    assert replied == allowed
    assert asked == {who: names for who, names in allowed.items() if names}


def answering(asked: dict[str, set[str]]) -> Callable[[zenoh.Query], None]:
    """A server that notes the keys that it is asked for, by who asks."""

    def reply(query: zenoh.Query) -> None:
        with query:
            asker = "unknown" if query.payload is None else query.payload.to_string()
            asked.setdefault(asker, set()).add(short(query.key_expr))
            query.reply(query.key_expr, "y")

    return reply


def replies(session: zenoh.Session, name: str, payload: str) -> bool:
    return any(reply.ok is not None for reply in session.get(key(VEHICLE, name), payload=payload, timeout=2.0))


@pytest.mark.parametrize("who", EVERYBODY)
def test_nobody_but_services_answers_requests(bus: Bus, who: Who) -> None:
    with ExitStack() as ends:
        for name in (*ASKED, *(topic.name for topic in ALL_TOPICS)):
            reply = answering({})
            ends.callback(bus.sessions[who].declare_queryable(key(VEHICLE, name), reply, complete=True).undeclare)
        time.sleep(SETTLE_S)
        answered = {name for name in (*ASKED, "status") if replies(bus.inside, name, "inside")}
    assert answered == ({*ASKED, "status"} if who in SERVICES else set())


@pytest.mark.parametrize("who", EVERYBODY)
def test_liveliness_tokens_are_those_of_their_owners(bus: Bus, who: Who) -> None:
    liveliness = bus.sessions[who].liveliness()
    with ExitStack() as ends:
        for kind, name in TOKENS:
            ends.callback(liveliness.declare_token(liveliness_key(VEHICLE, kind, name)).undeclare)  # type: ignore[arg-type]
        time.sleep(SETTLE_S)
        found = {str(reply.ok.key_expr) for reply in bus.inside.liveliness().get(key(VEHICLE, "@alive/**")) if reply.ok}
    allowed = {liveliness_key(VEHICLE, *token) for token, owners in TOKENS.items() if who in owners}  # type: ignore[arg-type]
    assert found == allowed


def test_everybody_sees_which_services_are_there(bus: Bus) -> None:
    own = liveliness_key(VEHICLE, "service", "estimator")
    token = bus.inside.liveliness().declare_token(own)
    time.sleep(SETTLE_S)
    for who, session in bus.sessions.items():
        found = {str(reply.ok.key_expr) for reply in session.liveliness().get(key(VEHICLE, "@alive/**")) if reply.ok}
        assert own in found, who
    token.undeclare()  # type: ignore[no-untyped-call]


def connected(team: Team, port: int, name: str) -> Vehicle:
    return Vehicle.connect(VEHICLE, router=f"tls/127.0.0.1:{port}", keys=team.bundle(name), timeout_s=3.0)


def test_a_viewer_that_wants_to_fly_reads_why_that_is_denied(tmp_path: Path) -> None:
    team = make_team(tmp_path / "team")
    with (
        computer(team.bundle("vehicle-uav1"), tmp_path / "run") as (port, _people, bus),
        zenoh.open(client_config(bus, 3.0)) as inside,
    ):
        own = inside.liveliness().declare_token(liveliness_key(VEHICLE, "service", "router"))
        with connected(team, port, "viewer-eye") as viewer:
            for send in (viewer.hover, viewer.takeoff, viewer.land_on_spot):
                with pytest.raises(Refused, match=r"viewer-eye has no right to @.*: only pilots fly"):
                    send()
        connection = Connection(VEHICLE, secured(f"tls/127.0.0.1:{port}", team.bundle("viewer-eye")), 3.0)
        with pytest.raises(Refused, match=r"viewer-eye has no right to rover/command: only pilots fly"):
            connection.publish(ROVER_COMMAND, RoverCommand(t_ns=0, speed_rover_body_mps=1.0, yaw_rate_rover_rps=0.0))
        connection.close()
        with connected(team, port, "pilot-ana") as pilot, pytest.raises(Unreachable, match="no server replies on"):
            pilot.hover()
        own.undeclare()  # type: ignore[no-untyped-call]


def test_a_program_that_would_be_a_service_reads_which_address_to_take(tmp_path: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    with open_router(address, socket_of(tmp_path)):
        connection = Connection(VEHICLE, address, 3.0)
        with pytest.raises(Refused, match=r"only services of the vehicle send to clock: .* socket that `jezero ps`"):
            connection.publish(CLOCK, Clock(t_ns=0, epoch_id=1, wall_ns=0))
        connection.close()


def test_a_revoked_member_may_do_nothing(tmp_path: Path) -> None:
    team: Team = make_team(tmp_path / "team")
    team.revoke("pilot-bo")
    heard: list[str] = []
    with (
        computer(team.bundle("vehicle-uav1"), tmp_path / "run") as (port, _people, bus),
        zenoh.open(client_config(bus, 3.0)) as inside,
    ):
        subscriber = inside.declare_subscriber(
            key(VEHICLE, "rover/command"), lambda s: heard.append(s.payload.to_string())
        )
        for name in ("pilot-bo", "pilot-ana"):
            with zenoh.open(client_config(secured(f"tls/127.0.0.1:{port}", team.bundle(name)), 3.0)) as session:
                session.put(key(VEHICLE, "rover/command"), name, congestion_control=BLOCK)
                time.sleep(SETTLE_S)
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert heard == ["pilot-ana"]


def test_a_router_without_the_list_of_members_does_not_listen(tmp_path: Path) -> None:
    bundle = make_team(tmp_path).bundle("vehicle-uav1")
    (bundle / MEMBERS_FILE).unlink()
    links = HostLinks(listen=(secured(f"tls/127.0.0.1:{free_port()}", bundle),))
    with pytest.raises(ListenError, match=r"members\.json is missing: copy the whole folder"):
        open_gate(socket_of(tmp_path), VEHICLE, links)
    links = HostLinks(listen=(f"tls/127.0.0.1:{free_port()}",))
    with pytest.raises(ListenError, match="a router with TLS needs the bundle of its computer"):
        open_gate(socket_of(tmp_path), VEHICLE, links)


# -- the same rights, by the names alone --


@pytest.mark.parametrize(
    ("role", "names"),
    [
        ("viewer", ()),
        ("pilot", ("@control/hover", "@action/go_to", "command/velocity")),
        ("rover", ("rover/odometry", "health/rover")),
        ("vehicle", ("odometry", "command/setpoint", "health/estimator", "rover/odometry")),
    ],
)
def test_what_a_role_may_send_by_its_name(role: Role, names: tuple[str, ...]) -> None:
    every = {"@control/hover", "@action/go_to", "command/velocity", "odometry", "command/setpoint", "health/estimator"}
    for name in names:
        assert may_send(role, name), name
    if role != "vehicle":
        assert [name for name in sorted(every - set(names)) if may_send(role, name)] == []
