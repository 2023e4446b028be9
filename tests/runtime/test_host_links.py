"""Routers of several computers: what crosses the link between them, who may what, and what a missing link is called."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh

from jezero.base.zenoh_client import client_config
from jezero.keys.bundle import secured
from jezero.keys.team import Team
from jezero.runtime.gate import Uplinks
from jezero.runtime.instance import HostLinks, socket_of
from jezero.runtime.routing import (
    COMMANDS_MAX_HZ,
    MESSAGES_MAX_HZ,
    ListenError,
    check_local,
    link_rules,
    open_gate,
    open_router,
)
from jezero.schemas.rows import Topic
from jezero.schemas.topics import (
    ABORT,
    ACQUIRE,
    CLOCK,
    HOVER,
    LAND_ON_SPOT,
    ROVER_COMMAND,
    ROVER_ODOMETRY,
    TOPICS,
    feedback_of,
    health_of,
    journal_of,
    key,
)
from tests.keys.rig import free_port, make_team

pytestmark = pytest.mark.process

VEHICLE = "uav1"
LATEST_S = 5.0
PERIOD_S, SENT = 0.01, 100
FLOOD = 2000
SETTLE_S = 0.5
CROSSING: list[Topic[Any]] = [*TOPICS, feedback_of(LAND_ON_SPOT), health_of("estimator"), journal_of("estimator")]


def wait_until(condition: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + LATEST_S
    while not condition() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return condition()


@dataclass
class Hosts:
    """A vehicle's and a ground computer, linked by a radio with TLS.

    Attributes:
        vehicle, ground: session of a program on each.
        ground_gate: session of the gate of the ground computer.
        address: where the vehicle's router listens to others.
    """

    vehicle: zenoh.Session
    ground: zenoh.Session
    ground_gate: zenoh.Session
    address: str


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Team:
    return make_team(tmp_path_factory.mktemp("team"))


def open_host(folder: Path, links: HostLinks, ends: ExitStack) -> zenoh.Session:
    """Open a computer's router and gate; returns the session of the gate.

    Args:
        folder: the computer's run folder.
    """
    bus = socket_of(folder)
    ends.enter_context(open_router(f"tcp/127.0.0.1:{free_port()}", bus))
    gate = open_gate(bus, VEHICLE, links)
    # A session that is left by its own `with` refuses every other thread meanwhile ("Already mutably borrowed").
    ends.enter_context(closing(gate))
    return gate


def linked(gate: zenoh.Session) -> bool:
    """Whether a gate is linked with the router of its own computer and with another one."""
    return len(list(gate.info.routers_zid())) > 1


@pytest.fixture(scope="module")
def hosts(team: Team, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    vehicle, ground = (tmp_path_factory.mktemp(name) for name in ("vehicle", "ground"))
    address = f"tls/127.0.0.1:{free_port()}"
    with ExitStack() as ends:
        listen = HostLinks(listen=(secured(address, team.bundle("vehicle-uav1")),))
        connect = HostLinks(connect=(secured(address, team.bundle("ground-lab")),))
        open_host(vehicle, listen, ends)
        ground_gate = open_host(ground, connect, ends)
        assert wait_until(lambda: linked(ground_gate))
        one, other = (
            ends.enter_context(zenoh.open(client_config(socket_of(each), LATEST_S))) for each in (vehicle, ground)
        )
        yield Hosts(one, other, ground_gate, address)


def test_each_topic_crosses_the_link_at_the_rate_of_the_table(hosts: Hosts) -> None:
    counts = dict.fromkeys((topic.name for topic in CROSSING), 0)

    def count(sample: zenoh.Sample) -> None:
        counts[str(sample.key_expr).partition(f"{VEHICLE}/")[2]] += 1

    subscribers = [hosts.ground.declare_subscriber(key(VEHICLE, name), count) for name in counts]
    publishers = [hosts.vehicle.declare_publisher(key(VEHICLE, name)) for name in counts]
    time.sleep(SETTLE_S)
    begin_s = time.monotonic()
    for _ in range(SENT):
        for publisher in publishers:
            publisher.put(b"{}")
        time.sleep(PERIOD_S)
    elapsed_s = time.monotonic() - begin_s
    time.sleep(SETTLE_S)
    for subscriber in subscribers:
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    for topic in CROSSING:
        crossed = counts[topic.name]
        if topic.link_hz is None:  # but a busy machine sends some of them closer together than a flood may be
            assert crossed > SENT // 2, topic.name
        else:
            assert crossed <= topic.link_hz * elapsed_s + 1, topic.name
            assert (crossed > 0) == (topic.link_hz > 0), topic.name


def test_the_health_of_router_and_gate_stays_on_their_computer(hosts: Hosts) -> None:
    heard: list[zenoh.Sample] = []
    subscriber = hosts.ground.declare_subscriber(key(VEHICLE, health_of("*").name), heard.append)
    time.sleep(SETTLE_S)
    for name in ("router", "gate", "estimator"):
        hosts.vehicle.put(key(VEHICLE, health_of(name).name), b"{}", congestion_control=zenoh.CongestionControl.BLOCK)
    assert wait_until(lambda: bool(heard))
    time.sleep(SETTLE_S)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert [str(sample.key_expr) for sample in heard] == [key(VEHICLE, health_of("estimator").name)]


def test_programs_behind_the_grounds_router_have_the_rights_of_its_certificate(hosts: Hosts) -> None:
    heard: list[str] = []

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, "{}")

    declared: list[Any] = []
    for topic in (ROVER_COMMAND, CLOCK, ROVER_ODOMETRY):
        own = key(VEHICLE, topic.name)
        declared.append(hosts.vehicle.declare_subscriber(own, lambda sample: heard.append(str(sample.key_expr))))
    for endpoint in (HOVER, ACQUIRE):
        declared.append(hosts.vehicle.declare_queryable(key(VEHICLE, endpoint.name), reply))
    time.sleep(SETTLE_S)
    for topic in (CLOCK, ROVER_ODOMETRY, ROVER_COMMAND):
        hosts.ground.put(key(VEHICLE, topic.name), b"{}", congestion_control=zenoh.CongestionControl.BLOCK)
    assert wait_until(lambda: key(VEHICLE, ROVER_COMMAND.name) in heard)
    answered = {
        endpoint: any(reply.ok for reply in hosts.ground.get(key(VEHICLE, endpoint.name), timeout=2.0))
        for endpoint in (HOVER, ACQUIRE)
    }
    for each in declared:
        each.undeclare()
    assert heard == [key(VEHICLE, ROVER_COMMAND.name)]
    assert answered == {HOVER: True, ACQUIRE: False}


def test_a_link_that_is_there_is_no_problem(hosts: Hosts, team: Team) -> None:
    uplinks = Uplinks(hosts.ground_gate, (secured(hosts.address, team.bundle("ground-lab")),))
    time.sleep(SETTLE_S)
    assert uplinks.problem == ""


def test_a_missing_link_is_named_with_its_reason(team: Team, tmp_path: Path) -> None:
    stranger = make_team(tmp_path / "strangers")
    address, nobody = f"tls/127.0.0.1:{free_port()}", f"tls/127.0.0.1:{free_port()}"
    listen = HostLinks(listen=(secured(address, team.bundle("vehicle-uav1")),))
    wrong = tuple(secured(each, stranger.bundle("ground-lab")) for each in (address, nobody))
    with ExitStack() as ends:
        open_host(tmp_path / "vehicle", listen, ends)
        uplinks = Uplinks(open_host(tmp_path / "ground", HostLinks(connect=wrong), ends), wrong)
        assert wait_until(lambda: "another team's" in uplinks.problem)
        assert f"no link to {address}: the router at {address} is another team's" in uplinks.problem
        assert f"no link to {nobody}: no router replies there" in uplinks.problem


def test_a_router_works_alone_and_links_to_the_other_when_that_comes(team: Team, tmp_path: Path) -> None:
    vehicle, ground, address = tmp_path / "vehicle", tmp_path / "ground", f"tls/127.0.0.1:{free_port()}"
    connect = HostLinks(connect=(secured(address, team.bundle("ground-lab")),))
    listen = HostLinks(listen=(secured(address, team.bundle("vehicle-uav1")),))
    with ExitStack() as ends:
        early = open_host(ground, connect, ends)
        program = ends.enter_context(zenoh.open(client_config(socket_of(ground), LATEST_S)))
        assert program.info.routers_zid() and not linked(early)
        open_host(vehicle, listen, ends)
        assert wait_until(lambda: linked(early))


def test_links_without_tls_leave_out_the_same_on_every_network_but_the_loopback() -> None:
    with_tls = link_rules(VEHICLE, ["tls/10.0.0.1:7448#files"])
    both = link_rules(VEHICLE, ["tcp/10.0.0.1:7448"])
    assert {*(protocol for each in with_tls for protocol in each["link_protocols"])} == {"tls"}
    without = [each for each in both if each["link_protocols"] == ["tcp"]]
    assert [each["rules"] for each in without] == [each["rules"] for each in with_tls]
    assert not any("lo" in each["interfaces"] for each in without)


def test_a_flood_from_another_computer_arrives_as_what_a_person_may_send(hosts: Hosts) -> None:
    asked: list[float] = []
    heard: list[zenoh.Sample] = []

    def reply(query: zenoh.Query) -> None:
        asked.append(time.monotonic())
        with query:
            query.reply(query.key_expr, "{}")

    queryables = [hosts.vehicle.declare_queryable(key(VEHICLE, each.name), reply) for each in (HOVER, ABORT)]
    subscriber = hosts.vehicle.declare_subscriber(key(VEHICLE, ROVER_COMMAND.name), heard.append)
    time.sleep(SETTLE_S)
    begin_s = time.monotonic()
    for _ in range(FLOOD):
        hosts.ground.get(key(VEHICLE, HOVER.name), lambda _reply: None, timeout=2.0)
        hosts.ground.put(key(VEHICLE, ROVER_COMMAND.name), b"{}", congestion_control=zenoh.CongestionControl.BLOCK)
    elapsed_s = time.monotonic() - begin_s
    time.sleep(SETTLE_S)
    assert 0 < len(asked) <= COMMANDS_MAX_HZ * (elapsed_s + SETTLE_S) + 1
    assert 0 < len(heard) <= MESSAGES_MAX_HZ * (elapsed_s + SETTLE_S) + 1
    assert any(reply.ok for reply in hosts.ground.get(key(VEHICLE, ABORT.name), timeout=2.0)), "another key"
    for each in (*queryables, subscriber):
        each.undeclare()  # type: ignore[attr-defined]


@pytest.mark.parametrize("address", ["tcp/0.0.0.0:7447", "tls/127.0.0.1:7447#files", "tcp/uav1.local:7447"])
def test_the_address_for_a_computers_own_programs_is_on_its_loopback(address: str) -> None:
    with pytest.raises(ListenError, match="--listen"):
        check_local(address)


def test_the_usual_addresses_are_on_the_loopback() -> None:
    for address in ("tcp/127.0.0.1:7447", "tcp/localhost:7447", "tcp/[::1]:7447", "unixsock-stream/run/z.sock"):
        check_local(address)
