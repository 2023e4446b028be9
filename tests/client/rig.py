"""A router on a free loopback port and a hand-made server, for tests of the client."""

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest
import zenoh

from jezero import Vehicle
from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Feedback, Result
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.goals import MoveFeedback, MoveResult, VelocityFeedback, VelocityResult
from jezero.schemas.rows import Topic
from jezero.schemas.state import Odometry, Status, StatusCode
from jezero.schemas.struct import Message, Payload

POINT = (0.0, 0.0, -2.0)
ODOMETRY = Odometry(
    t_ns=9,
    epoch_id=1,
    pos_uav_ned_m=(1.0, 2.0, -2.0),
    vel_uav_ned_mps=(0.0, 0.0, 0.0),
    q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
    rates_uav_frd_rps=(0.0, 0.0, 0.0),
)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def open_router(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/delay", "0")
    return zenoh.open(config)


def a_status(code: StatusCode = StatusCode.HOVER, t_ns: int = 9, ready: bool = True, missing: str = "") -> Status:
    return Status(
        t_ns=t_ns,
        code=int(code),
        name=code.name,
        odometry=ODOMETRY,
        armed=code != StatusCode.IDLE,
        landed=code == StatusCode.IDLE,
        in_charge="hover",
        bridge_boot_id=1,
        ready=ready,
        not_ready_reason=missing,
    )


class Server:
    """Answers on the keys of vehicle `v` as a stack would.

    Attributes:
        asked: names of the keys, with client id and payload.
        open: queries that were not ended yet, by key.
        clients: sessions that shall know of a new server before the test goes on.
    """

    def __init__(self, endpoint: str) -> None:
        self.session = zenoh.open(client_config(endpoint))
        self._probe = zenoh.open(client_config(endpoint))
        self.asked: list[tuple[str, str, Any]] = []
        self.open: dict[str, list[zenoh.Query]] = {}
        self.clients: list[zenoh.Session] = []
        self._queryables: list[Any] = []
        self._replies = threading.Lock()
        """Held while replies are sent from Zenoh's thread: a query can't be dropped meanwhile."""
        bridge = topics.liveliness_key("v", "service", "vehicle_bridge")
        self._alive = self.session.liveliness().declare_token(bridge)

    def serve(self, name: str, *replies: Payload, end: bool = True, complete: bool = True) -> None:
        def on_query(query: zenoh.Query) -> None:
            payload, attachment = query.payload, query.attachment
            fields = msgspec.json.decode(payload.to_bytes()) if payload else None
            self.asked.append((name, attachment.to_bytes().decode() if attachment else "", fields))
            if not end:
                self.open.setdefault(name, []).append(query)
            with self._replies:
                for reply in replies:
                    self.reply(query, reply)
            if end:
                self.end(query)

        key = topics.key("v", name)
        callback = zenoh.handlers.Callback(on_query, indirect=False)
        self._queryables.append(self.session.declare_queryable(key, callback, complete=complete))
        for session in (self._probe, *self.clients):
            wait_until_served(session, key)

    def reply(self, query: zenoh.Query, reply: Payload) -> None:
        query.reply(query.key_expr, msgspec.json.encode(reply), encoding=zenoh.Encoding.APPLICATION_JSON)

    def end(self, query: zenoh.Query) -> None:
        """Send no more replies to a query."""
        with self._replies:
            query.drop()  # type: ignore[no-untyped-call]

    def publish_status(self, status: Status) -> None:
        self.publish(topics.STATUS, status)

    def publish(self, topic: Topic[Any], message: Message) -> None:
        block = zenoh.CongestionControl.BLOCK  # a busy machine drops nothing
        self.session.put(topics.key("v", topic.name), msgspec.json.encode(message), congestion_control=block)

    def close(self) -> None:
        self.open.clear()
        close(self.session)
        close(self._probe)


def close(session: zenoh.Session) -> None:
    if not session.is_closed():
        session.close()  # type: ignore[no-untyped-call]


def wait_for(condition: Callable[[], object], within_s: float = 3.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, "it did not happen"
        time.sleep(0.005)


def wait_until_served(session: zenoh.Session, key: str) -> None:
    """Until the router, and through it the session, knows of a server on the key."""
    querier = session.declare_querier(key)

    def is_known() -> bool:
        status: Any = querier.matching_status
        return bool(status.matching)

    wait_for(is_known)
    querier.undeclare()  # type: ignore[no-untyped-call]


def wait_until_subscribed(session: zenoh.Session, key: str) -> None:
    """Until the router, and through it the session, knows of a subscriber of the key: what is published
    before is lost."""
    publisher = session.declare_publisher(key)

    def is_known() -> bool:
        status: Any = publisher.matching_status
        return bool(status.matching)

    wait_for(is_known)
    publisher.undeclare()  # type: ignore[no-untyped-call]


@contextmanager
def published(server: Server, make: Callable[[int], Message], topic: Topic[Any] = topics.STATUS) -> Iterator[None]:
    """Publish `make(t_ns)` every 20 ms, with growing times."""
    stop = threading.Event()

    def publish() -> None:
        t_ns = 100
        while not stop.wait(0.02):
            t_ns += 1
            server.publish(topic, make(t_ns))

    publisher = threading.Thread(target=publish)
    publisher.start()
    try:
        yield
    finally:
        stop.set()
        publisher.join()


def velocity_feedback(t_ns: int, limited_by: str = "") -> Feedback[VelocityFeedback]:
    content = VelocityFeedback(pos_uav_ned_m=POINT, follows=True, limited_by=limited_by)
    return Feedback(goal_id="g", t_ns=t_ns, code=14, feedback=content)


@contextmanager
def steerable(server: Server, stall_s: float = 0.0) -> Iterator[list[VelocityCommand]]:
    """An action server of `fly_velocity`, whose goal ends with the last command; yields the commands that it gets.

    Vehicle time begins at 1 s and grows by 0.1 s with each feedback. It stands still once, after the first command.

    Args:
        stall_s: how long it stands still.
    """
    action, commands, stop = topics.FLY_VELOCITY.endpoint.name, list[VelocityCommand](), threading.Event()
    server.serve(action, ACCEPTED, end=False)

    def on_command(sample: zenoh.Sample) -> None:
        commands.append(msgspec.json.decode(sample.payload.to_bytes(), type=VelocityCommand))

    key = topics.key("v", topics.VELOCITY_COMMAND.name)
    subscriber = server.session.declare_subscriber(key, on_command)

    def serve() -> None:
        t_ns, stall_left_s = 1_000_000_000, stall_s
        while not stop.wait(0.02):
            if commands and stall_left_s:
                stop.wait(stall_left_s)
                stall_left_s = 0.0
            for query in server.open.get(action, ()):
                server.reply(query, velocity_feedback(t_ns, "the fence"))
            t_ns += 100_000_000
            if any(command.is_last for command in commands) and action in server.open:
                (query,) = server.open.pop(action)
                ended = VelocityResult(completed=True, pos_uav_ned_m=POINT)
                server.reply(query, Result(goal_id="g", t_ns=t_ns, outcome="succeeded", result=ended))
                server.end(query)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield commands
    finally:
        stop.set()
        thread.join()
        subscriber.undeclare()  # type: ignore[no-untyped-call]


@contextmanager
def own_stack() -> Iterator[tuple[str, zenoh.Session, Server]]:
    """Endpoint, router and server of a test that stops the router itself."""
    endpoint = free_endpoint()
    router = open_router(endpoint)
    server = Server(endpoint)
    try:
        yield endpoint, router, server
    finally:
        server.close()
        close(router)


@pytest.fixture
def endpoint() -> Iterator[str]:
    endpoint = free_endpoint()
    router = open_router(endpoint)
    yield endpoint
    close(router)


@pytest.fixture
def server(endpoint: str) -> Iterator[Server]:
    server = Server(endpoint)
    yield server
    server.close()


@pytest.fixture
def vehicle(endpoint: str, server: Server) -> Iterator[Vehicle]:
    with Vehicle.connect("v", router=endpoint) as vehicle:
        server.clients.append(vehicle._connection._session)
        yield vehicle


def a_feedback(distance_m: float) -> Feedback[MoveFeedback]:
    return Feedback(
        goal_id="g", t_ns=1, code=1, feedback=MoveFeedback(pos_uav_ned_m=POINT, frame="world", distance_m=distance_m)
    )


def a_result(outcome: Any = "succeeded", reason: str = "") -> Result[MoveResult]:
    move = MoveResult(completed=outcome == "succeeded", pos_uav_ned_m=POINT)
    return Result(goal_id="g", t_ns=2, outcome=outcome, reason=reason, result=move)


ACCEPTED = Accepted(goal_id="g", warning="careful")
