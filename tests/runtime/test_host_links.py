"""Routers of several computers: what crosses the link between them, who may what, and what a missing link is called."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh

from jezero.keys.bundle import secured
from jezero.keys.team import Team
from jezero.runtime.config import HostLinks
from jezero.runtime.link_rules import link_rules
from jezero.runtime.router import ListenError, check_local, open_router
from jezero.runtime.uplinks import Uplinks
from jezero.schemas.rows import Topic
from jezero.schemas.topics import (
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
from jezero.zenoh_client import client_config
from tests.keys.rig import free_port, make_team

VEHICLE = "uav1"
LATEST_S = 5.0
PERIOD_S, SENT = 0.01, 100
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
        ground_router: session of the router of the ground computer.
        address: where the vehicle's router listens to others.
    """

    vehicle: zenoh.Session
    ground: zenoh.Session
    ground_router: zenoh.Session
    address: str


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Team:
    return make_team(tmp_path_factory.mktemp("team"))


def local() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture(scope="module")
def hosts(team: Team) -> Iterator[Hosts]:
    vehicle, ground, address = local(), local(), f"tls/127.0.0.1:{free_port()}"
    with ExitStack() as ends:
        listen = HostLinks(listen=(secured(address, team.bundle("vehicle-uav1")),))
        connect = HostLinks(connect=(secured(address, team.bundle("ground-lab")),))
        ends.enter_context(open_router(vehicle, VEHICLE, listen))
        ground_router = ends.enter_context(open_router(ground, VEHICLE, connect))
        assert wait_until(lambda: bool(ground_router.info.routers_zid()))
        one, other = (ends.enter_context(zenoh.open(client_config(each, LATEST_S))) for each in (vehicle, ground))
        yield Hosts(one, other, ground_router, address)


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
        if topic.link_hz is None:
            assert crossed == SENT, topic.name
        else:
            assert crossed <= topic.link_hz * elapsed_s + 1, topic.name
            assert (crossed > 0) == (topic.link_hz > 0), topic.name


def test_the_health_of_a_router_stays_on_its_computer(hosts: Hosts) -> None:
    heard: list[zenoh.Sample] = []
    subscriber = hosts.ground.declare_subscriber(key(VEHICLE, health_of("*").name), heard.append)
    time.sleep(SETTLE_S)
    for name in ("router", "estimator"):
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
    uplinks = Uplinks(hosts.ground_router, (secured(hosts.address, team.bundle("ground-lab")),))
    time.sleep(SETTLE_S)
    assert uplinks.problem == ""


def test_a_missing_link_is_named_with_its_reason(team: Team, tmp_path: Path) -> None:
    stranger = make_team(tmp_path)
    address, nobody = f"tls/127.0.0.1:{free_port()}", f"tls/127.0.0.1:{free_port()}"
    listen = HostLinks(listen=(secured(address, team.bundle("vehicle-uav1")),))
    wrong = tuple(secured(each, stranger.bundle("ground-lab")) for each in (address, nobody))
    with open_router(local(), VEHICLE, listen), open_router(local(), VEHICLE, HostLinks(connect=wrong)) as session:
        uplinks = Uplinks(session, wrong)
        assert wait_until(lambda: "another team's" in uplinks.problem)
        assert f"no link to {address}: the router at {address} is another team's" in uplinks.problem
        assert f"no link to {nobody}: no router replies there" in uplinks.problem


def test_a_router_works_alone_and_links_to_the_other_when_that_comes(team: Team) -> None:
    vehicle, ground, address = local(), local(), f"tls/127.0.0.1:{free_port()}"
    connect = HostLinks(connect=(secured(address, team.bundle("ground-lab")),))
    listen = HostLinks(listen=(secured(address, team.bundle("vehicle-uav1")),))
    with open_router(ground, VEHICLE, connect) as early:
        with zenoh.open(client_config(ground, LATEST_S)) as program:
            assert program.info.routers_zid()
        with open_router(vehicle, VEHICLE, listen):
            assert wait_until(lambda: bool(early.info.routers_zid()))


def test_links_without_tls_leave_out_the_same_on_every_network_but_the_loopback() -> None:
    with_tls = link_rules(VEHICLE, ["tls/10.0.0.1:7448#files"])
    without = link_rules(VEHICLE, ["tcp/10.0.0.1:7448"])
    assert [each["link_protocols"] for each in with_tls] == [["tls"]]
    assert [each["link_protocols"] for each in without] == [["tls"], ["tcp"]]
    assert without[1]["rules"] == with_tls[0]["rules"] and "lo" not in without[1]["interfaces"]


@pytest.mark.parametrize("address", ["tcp/0.0.0.0:7447", "tls/127.0.0.1:7447#files", "tcp/uav1.local:7447"])
def test_the_address_for_a_computers_own_programs_is_on_its_loopback(address: str) -> None:
    with pytest.raises(ListenError, match="--listen"):
        check_local(address)


def test_the_usual_addresses_are_on_the_loopback() -> None:
    for address in ("tcp/127.0.0.1:7447", "tcp/localhost:7447", "tcp/[::1]:7447", "unixsock-stream/run/z.sock"):
        check_local(address)
