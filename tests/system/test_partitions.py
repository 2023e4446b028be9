"""Partitions between a service or a client and the router: nothing stale is executed afterwards.

A partition shorter than Zenoh's lease of 2 s delivers everything late; a longer one also ends the session.
"""

import json
import math
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
import zenoh

from jezero import JezeroError, Vehicle
from jezero.base.codec import encode
from jezero.base.config import config_directory
from jezero.base.zenoh_client import client_config
from jezero.runtime.instance import PREFIX
from jezero.schemas import topics
from jezero.schemas.commands import Abort, Acquire, Hover
from jezero.schemas.goals import GoToGoal
from jezero.schemas.state import StatusCode
from jezero.schemas.struct import Payload
from tests.system.conftest import Stack, new_stack, wait_for, wait_for_status
from tests.system.relay import Relay

TIMEOUT_S = 60.0
SHORT_S, LONG_S = 1.5, 3.0
CALM_S = 2.0
"""Time after a partition in which nothing may happen."""
STAYS_WITHIN_M = 0.7
FAR_M = 30.0
BEHIND_RELAY = ("go_to", "vehicle_bridge", "client")


@dataclass
class RelayedStack:
    """A stack whose router two services and another one reach through relays.

    Attributes:
        stack: the stack.
        relays: relays by the names in `BEHIND_RELAY`.
    """

    stack: Stack
    relays: dict[str, Relay]

    def session(self, relay: str = "") -> zenoh.Session:
        """A session with the router, directly or through a relay."""
        return zenoh.open(client_config(self.address(relay) if relay else self.stack.bus))

    def address(self, relay: str) -> str:
        """Address of the router for services behind a relay."""
        return f"{self.stack.bus}.{relay}"

    def key(self, name: str) -> str:
        return topics.key(self.stack.instance.vehicle, name)

    def request(self, session: zenoh.Session, name: str, payload: Payload) -> list[dict[str, Any]]:
        """Send a request; its replies are appended to the list as they arrive."""
        replies: list[dict[str, Any]] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                replies.append(json.loads(reply.ok.payload.to_string()))

        streaming = zenoh.ConsolidationMode.NONE
        session.get(self.key(name), on_reply, payload=encode(payload), timeout=20.0, consolidation=streaming)
        return replies


@dataclass
class Recording:
    """Published messages as JSON.

    Attributes:
        statuses: (monotonic time of arrival, status).
        setpoints: (monotonic time of arrival, setpoint).
    """

    statuses: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    setpoints: list[tuple[float, dict[str, Any]]] = field(default_factory=list)

    def since(self, begin_s: float) -> list[dict[str, Any]]:
        """Statuses that arrived after a time."""
        return [status for at_s, status in self.statuses if at_s > begin_s]


@pytest.fixture(scope="module")
def relayed_stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RelayedStack]:
    folder = tmp_path_factory.mktemp("relayed")
    with ExitStack() as ends, new_stack(folder) as stack:
        stack.run_dir.mkdir(mode=0o700)
        bus = Path(stack.bus.removeprefix(PREFIX))
        relays = {name: ends.enter_context(Relay(bus, Path(f"{bus}.{name}"))) for name in BEHIND_RELAY}
        relayed = RelayedStack(stack, relays)
        compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
        for name in ("go_to", "vehicle_bridge"):
            service = compose["services"][name]
            service["command"] = f"env JEZERO_ROUTER={relayed.address(name)} {service['command']}"
            service["command"] = service["command"].replace("python", sys.executable, 1)
        (folder / "compose.yaml").write_text(yaml.safe_dump(compose))
        stack.up("-f", str(folder / "compose.yaml"))
        yield relayed


@pytest.fixture
def vehicle(relayed_stack: RelayedStack) -> Iterator[Vehicle]:
    """A client of the hovering vehicle, connected to the router directly."""
    with relayed_stack.stack.connect() as uav:
        uav.wait_ready(TIMEOUT_S)
        wait_for_status(uav, lambda s: s.code in (StatusCode.IDLE, StatusCode.HOVER), TIMEOUT_S, "at rest")
        if uav.status().code == StatusCode.IDLE:
            uav.takeoff(altitude_m=2.0).result(timeout_s=TIMEOUT_S)
        yield uav


@pytest.fixture
def recording(relayed_stack: RelayedStack) -> Iterator[Recording]:
    """Statuses and setpoints that are published during the test."""
    found = Recording()
    with relayed_stack.session() as session:
        for topic, into in ((topics.STATUS, found.statuses), (topics.SETPOINT, found.setpoints)):

            def on_sample(sample: zenoh.Sample, into: list[tuple[float, dict[str, Any]]] = into) -> None:
                into.append((time.monotonic(), json.loads(sample.payload.to_string())))

            session.declare_subscriber(relayed_stack.key(topic.name), on_sample)
        yield found


def position(status: dict[str, Any]) -> tuple[float, float, float]:
    x_m, y_m, z_m = status["odometry"]["pos_uav_ned_m"]
    return x_m, y_m, z_m


def assert_stays(recording: Recording, begin_s: float) -> None:
    """Assert that the vehicle hovers in place without a goal, from a time until `CALM_S` from now."""
    time.sleep(CALM_S)  # the time in which nothing happens
    statuses = recording.since(begin_s)
    assert len(statuses) > 5
    assert {(status["code"], status["in_charge"]) for status in statuses} == {(StatusCode.HOVER, "hover")}
    start_ned_m = position(statuses[0])
    assert max(math.dist(position(status), start_ned_m) for status in statuses) < STAYS_WITHIN_M


@pytest.mark.long
@pytest.mark.parametrize("partition_s", [SHORT_S, LONG_S])
@pytest.mark.parametrize("name", ["go_to", "vehicle_bridge"])
def test_setpoints_that_a_partition_held_back_are_not_flown(
    relayed_stack: RelayedStack, vehicle: Vehicle, recording: Recording, name: str, partition_s: float
) -> None:
    odometry = vehicle.status().odometry
    assert odometry is not None
    x_m = odometry.pos_uav_ned_m[0]
    goal = vehicle.go_to(FAR_M if x_m < FAR_M / 2 else 0.0, 0.0, -2.0, speed_mps=1.0)
    wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, TIMEOUT_S, "flying to the target")
    wait_for(lambda: len(recording.setpoints) > 25, TIMEOUT_S, "setpoints of half a second")
    with relayed_stack.relays[name].partition():
        begin_s = time.monotonic()
        time.sleep(partition_s)
    end_s = time.monotonic()
    with pytest.raises(JezeroError):
        goal.result(timeout_s=TIMEOUT_S)
    wait_for(lambda: bool(recording.since(end_s + 0.5)), TIMEOUT_S, "a status after the partition")
    calm_s = time.monotonic()
    hovering = [
        at_s for at_s, status in recording.statuses if status["code"] == StatusCode.HOVER and at_s > begin_s + 0.1
    ]
    if name == "go_to":
        assert hovering[0] < end_s  # it didn't wait for the end of the partition
    if (name, partition_s) == ("go_to", SHORT_S):
        assert [at_s for at_s, _ in recording.setpoints if at_s > end_s]  # they did arrive, late
    assert_stays(recording, calm_s)
    assert relayed_stack.stack.processes() == relayed_stack.stack.processes_cached


def test_requests_that_a_client_sent_before_a_long_partition_are_not_executed_after_it(
    relayed_stack: RelayedStack, vehicle: Vehicle, recording: Recording
) -> None:
    begin_s = time.monotonic()
    x_m, y_m, z_m = (vehicle.status().odometry or pytest.fail("no odometry")).pos_uav_ned_m
    there = (x_m + 5.0, y_m, z_m)
    with relayed_stack.session("client") as session:
        with relayed_stack.relays["client"].partition():
            partition_begin_s = time.monotonic()
            replies = [
                relayed_stack.request(
                    session, topics.GO_TO.endpoint.name, GoToGoal(goal_id="late", target_ned_m=there)
                ),
                relayed_stack.request(session, topics.HOVER.name, Hover(hover_pos=there)),
                relayed_stack.request(session, topics.ABORT.name, Abort(reason="late")),
                relayed_stack.request(session, topics.ACQUIRE.name, Acquire(goal_id="late", action="go_to")),
            ]
            wait_for(lambda: time.monotonic() - partition_begin_s > LONG_S, TIMEOUT_S, "the partition's end")
        wait_for(lambda: bool(session.info.routers_zid()), TIMEOUT_S, "the client connected again")
        assert_stays(recording, begin_s)
    assert replies == [[], [], [], []]


def test_control_that_was_requested_before_a_short_partition_is_not_granted_after_it(
    relayed_stack: RelayedStack, vehicle: Vehicle, recording: Recording
) -> None:
    """The action server has rejected the goal when its request arrives at the bridge."""
    begin_s = time.monotonic()
    with relayed_stack.session() as session:
        with relayed_stack.relays["vehicle_bridge"].partition():
            partition_begin_s = time.monotonic()
            goal = GoToGoal(goal_id=f"late-{partition_begin_s:.0f}", target_ned_m=(5.0, 5.0, -3.0))
            replies = relayed_stack.request(session, topics.GO_TO.endpoint.name, goal)
            wait_for(lambda: bool(replies), TIMEOUT_S, "the server's reply")
            assert "the vehicle bridge did not reply" in replies[0]["reason"]
            wait_for(lambda: time.monotonic() - partition_begin_s > SHORT_S, TIMEOUT_S, "the partition's end")
        assert_stays(recording, begin_s)
