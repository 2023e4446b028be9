"""A service or a client that is cut off from the router for a while: nothing stale is executed afterwards.

A partition shorter than Zenoh's lease of 2 s delivers everything late; a longer one costs the session as well.
"""

import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import pytest
import yaml
import zenoh

from jezero import JezeroError, Vehicle
from jezero.codec import encode
from jezero.runtime.config import config_directory
from jezero.schemas import topics
from jezero.schemas.actions import GoToGoal
from jezero.schemas.commands import Abort, Acquire, Hover
from jezero.schemas.state import StatusCode
from jezero.schemas.struct import Payload
from jezero.zenoh_client import client_config
from tests.system.conftest import Stack, new_stack, wait_for, wait_for_status
from tests.system.relay import Relay

PATIENCE_S = 60.0
SHORT_S, LONG_S = 1.5, 3.0
AFTERWARDS_S = 2.0
"""For so long nothing may happen after a partition."""
STAYS_WITHIN_M = 0.7
FAR_M = 30.0
BEHIND = ("go_to", "vehicle_bridge", "client")


@dataclass
class CutOff:
    """A stack, and relays in front of its router: of two services, and of a client."""

    stack: Stack
    relays: dict[str, Relay]

    def session(self, relay: str = "") -> zenoh.Session:
        """On the router, or through a relay."""
        router = f"tcp/127.0.0.1:{self.relays[relay].port}" if relay else self.stack.instance.router
        return zenoh.open(client_config(router))

    def key(self, name: str) -> str:
        return topics.key(self.stack.instance.vehicle, name)

    def ask(self, session: zenoh.Session, name: str, question: Payload) -> list[dict[str, Any]]:
        """Put a question; what is answered comes into the list."""
        answers: list[dict[str, Any]] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answers.append(json.loads(reply.ok.payload.to_string()))

        streaming = zenoh.ConsolidationMode.NONE
        session.get(self.key(name), on_reply, payload=encode(question), timeout=20.0, consolidation=streaming)
        return answers


@dataclass
class Heard:
    """What is published, as JSON: `(monotonic time of arrival, message)`."""

    statuses: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    setpoints: list[tuple[float, dict[str, Any]]] = field(default_factory=list)

    def since(self, begin_s: float) -> list[dict[str, Any]]:
        """Statuses that arrived after a moment."""
        return [status for at_s, status in self.statuses if at_s > begin_s]


@pytest.fixture(scope="module")
def cut_off(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CutOff]:
    folder = tmp_path_factory.mktemp("cut_off")
    with ExitStack() as ends, new_stack(folder) as stack:
        port = int(stack.instance.router.rpartition(":")[2])
        relays = {name: ends.enter_context(Relay(port)) for name in BEHIND}
        compose = yaml.safe_load((config_directory().parent / "compose.yaml").read_text())
        for name in ("go_to", "vehicle_bridge"):
            usual = compose["services"][name]["environment"]
            relayed = {"JEZERO_ROUTER": f"tcp/127.0.0.1:{relays[name].port}"}
            compose["services"][name]["environment"] = {**usual, **relayed}
        (folder / "compose.yaml").write_text(yaml.safe_dump(compose))
        yield CutOff(stack.up("-f", str(folder / "compose.yaml")), relays)


@pytest.fixture
def vehicle(cut_off: CutOff) -> Iterator[Vehicle]:
    """Hovering; the client is connected to the router itself."""
    with cut_off.stack.connect() as uav:
        uav.wait_ready(PATIENCE_S)
        wait_for_status(uav, lambda s: s.code in (StatusCode.IDLE, StatusCode.HOVER), PATIENCE_S, "at rest")
        if uav.status().code == StatusCode.IDLE:
            uav.takeoff(altitude_m=2.0).result(timeout_s=PATIENCE_S)
        yield uav


@pytest.fixture
def heard(cut_off: CutOff) -> Iterator[Heard]:
    """What is published during the test."""
    found = Heard()
    with cut_off.session() as session:
        for topic, into in ((topics.STATUS, found.statuses), (topics.SETPOINT, found.setpoints)):

            def on_sample(sample: zenoh.Sample, into: list[tuple[float, dict[str, Any]]] = into) -> None:
                into.append((time.monotonic(), json.loads(sample.payload.to_string())))

            session.declare_subscriber(cut_off.key(topic.name), on_sample)
        yield found


def position(status: dict[str, Any]) -> tuple[float, float, float]:
    x_m, y_m, z_m = status["odometry"]["pos_uav_ned_m"]
    return x_m, y_m, z_m


def assert_stays(heard: Heard, begin_s: float) -> None:
    """Since then, and for a while from now on, it hovers under nobody's command and doesn't move away."""
    time.sleep(AFTERWARDS_S)  # the time in which nothing happens
    statuses = heard.since(begin_s)
    assert len(statuses) > 5
    assert {(status["code"], status["in_charge"]) for status in statuses} == {(StatusCode.HOVER, "hover")}
    stood = position(statuses[0])
    assert max(math.dist(position(status), stood) for status in statuses) < STAYS_WITHIN_M


@pytest.mark.parametrize("parted_s", [SHORT_S, LONG_S])
@pytest.mark.parametrize("name", ["go_to", "vehicle_bridge"])
def test_setpoints_that_a_partition_held_back_are_not_flown(
    cut_off: CutOff, vehicle: Vehicle, heard: Heard, name: str, parted_s: float
) -> None:
    odometry = vehicle.status().odometry
    assert odometry is not None
    x_m = odometry.pos_uav_ned_m[0]
    goal = vehicle.go_to(FAR_M if x_m < FAR_M / 2 else 0.0, 0.0, -2.0, speed_mps=1.0)
    wait_for_status(vehicle, lambda s: s.code == StatusCode.GO_TO, PATIENCE_S, "flying to the target")
    wait_for(lambda: len(heard.setpoints) > 25, PATIENCE_S, "setpoints of half a second")
    with cut_off.relays[name].parted():
        begin_s = time.monotonic()
        time.sleep(parted_s)
    end_s = time.monotonic()
    with pytest.raises(JezeroError):
        goal.result(timeout_s=PATIENCE_S)
    wait_for(lambda: bool(heard.since(end_s + 0.5)), PATIENCE_S, "a status after the partition")
    calm_s = time.monotonic()
    hovering = [at_s for at_s, status in heard.statuses if status["code"] == StatusCode.HOVER and at_s > begin_s + 0.1]
    if name == "go_to":
        assert hovering[0] < end_s  # it didn't wait for the end of the partition
    if (name, parted_s) == ("go_to", SHORT_S):
        assert [at_s for at_s, _ in heard.setpoints if at_s > end_s]  # they did arrive, late
    assert_stays(heard, calm_s)
    assert cut_off.stack.processes() == cut_off.stack.processes_cached


def test_what_a_client_asked_for_before_a_long_partition_is_not_done_after_it(
    cut_off: CutOff, vehicle: Vehicle, heard: Heard
) -> None:
    begin_s = time.monotonic()
    x_m, y_m, z_m = (vehicle.status().odometry or pytest.fail("no odometry")).pos_uav_ned_m
    there = (x_m + 5.0, y_m, z_m)
    with cut_off.session("client") as session:
        with cut_off.relays["client"].parted():
            parted_s = time.monotonic()
            answers = [
                cut_off.ask(session, topics.GO_TO.endpoint.name, GoToGoal(goal_id="late", target_ned_m=there)),
                cut_off.ask(session, topics.HOVER.name, Hover(hover_pos=there)),
                cut_off.ask(session, topics.ABORT.name, Abort(reason="late")),
                cut_off.ask(session, topics.ACQUIRE.name, Acquire(goal_id="late", action="go_to")),
            ]
            wait_for(lambda: time.monotonic() - parted_s > LONG_S, PATIENCE_S, "the partition's end")
        wait_for(lambda: bool(session.info.routers_zid()), PATIENCE_S, "the client connected again")
        assert_stays(heard, begin_s)
    assert answers == [[], [], [], []]


def test_control_that_was_asked_for_before_a_short_partition_is_not_given_after_it(
    cut_off: CutOff, vehicle: Vehicle, heard: Heard
) -> None:
    """The action server has rejected the goal when its question arrives."""
    begin_s = time.monotonic()
    with cut_off.session() as session:
        with cut_off.relays["vehicle_bridge"].parted():
            parted_s = time.monotonic()
            goal = GoToGoal(goal_id=f"late-{parted_s:.0f}", target_ned_m=(5.0, 5.0, -3.0))
            answers = cut_off.ask(session, topics.GO_TO.endpoint.name, goal)
            wait_for(lambda: bool(answers), PATIENCE_S, "the server's answer")
            assert "the vehicle bridge did not reply" in answers[0]["reason"]
            wait_for(lambda: time.monotonic() - parted_s > SHORT_S, PATIENCE_S, "the partition's end")
        assert_stays(heard, begin_s)
