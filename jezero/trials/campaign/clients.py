"""Clients that send goals and requests at random, independently of each other."""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from random import Random
from typing import Any

import msgspec

from jezero.base.codec import BadPayloadError, decode
from jezero.base.plugins import all_actions
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import (
    Accepted,
    Cancel,
    GetResult,
    Modify,
    ModifyReply,
    Pause,
    PauseReply,
    Rejected,
    Result,
    Resume,
    ResumeReply,
)
from jezero.schemas.commands import Abort, Hover, Kill
from jezero.schemas.goals import Goal
from jezero.schemas.rows import Action, Endpoint
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.units import NS_PER_S

PERIOD_S = 0.5
ACTION_INTERVAL_MEAN_S = 3.0
RESULT_QUERY_PERIOD_S = 3.0
PAUSE_PROBABILITY, RESUME_PROBABILITY, MODIFY_PROBABILITY = 0.12, 0.3, 0.06
"""Probabilities that a request is sent in one period, while a goal is flown or paused."""
FIELD_DRAWS: dict[str, Callable[[Random], Any]] = {
    "altitude_m": lambda rng: rng.uniform(0.6, 5.0),
    "target_ned_m": lambda rng: (rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0), rng.uniform(-6.0, -1.5)),
    "landing_spot_ned_m": lambda rng: (rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0), 0.0),
    "center_ned_m": lambda rng: (rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0), rng.uniform(-6.0, -3.0)),
    "radius_m": lambda rng: rng.uniform(1.0, 4.0),
    "num_images": lambda rng: rng.randint(1, 12),
    "polygon_ned_m": lambda rng: ((0.0, 0.0), (rng.uniform(2.0, 6.0), 0.0), (0.0, rng.uniform(2.0, 6.0))),
    "z_ned_m": lambda rng: rng.uniform(-6.0, -2.0),
    "resolution_m": lambda rng: rng.uniform(0.5, 1.5),
    "do_takeoff": lambda rng: rng.random() < 0.5,
    "frame": lambda rng: rng.choice(("world", "world", "world", "rover")),
    "use_uwb": lambda rng: rng.random() < 0.4,
    "use_tag": lambda rng: rng.random() < 0.4,
    "speed_mps": lambda rng: rng.choice((None, rng.uniform(0.5, 4.0))),
    "yaw_rad": lambda rng: rng.choice((None, rng.uniform(-3.1, 3.1))),
    "on_client_loss": lambda rng: rng.choice(("continue", "cancel")),
}
"""Functions that draw the fields of goals, by field name; fields without one keep their defaults."""


def draw_goal(action: Action[Any], rng: Random, goal_id: str, t_ns: int) -> Goal:
    """Draw a valid goal, whether or not the vehicle can fly it now.

    Raises:
        KeyError: the action's goal has a field without a default that is missing in FIELD_DRAWS.
    """
    values: dict[str, Any] = {"goal_id": goal_id, "issued_t_ns": t_ns}
    for info in msgspec.structs.fields(action.goal_type):
        if info.name in FIELD_DRAWS:
            values[info.name] = FIELD_DRAWS[info.name](rng)
        elif info.required and info.name not in values:
            raise KeyError(f"FIELD_DRAWS has no entry for the field {info.name} of {action.name}")
    goal: Goal = action.goal_type(**values)
    return goal


@dataclass
class SentGoal:
    """A goal that a client sent, and the client's knowledge of its outcome.

    Attributes:
        goal: the goal.
        action: the goal's action.
        queries: one query for each time that the goal was sent.
        result_query: the last query for the goal's result.
        result_queried_ns: time of that query, or of the goal's first sending.
        known_outcome: the outcome, "rejected", or "" while the client knows none.
    """

    goal: Goal
    action: Action[Any]
    queries: list[SentRequest] = field(default_factory=list)
    result_query: SentRequest | None = None
    result_queried_ns: int = 0
    known_outcome: str = ""

    @property
    def accepted(self) -> bool:
        return any(isinstance(reply, Accepted) for query in self.queries for reply in query.replies)


class Pauser:
    """Sends the requests about one client's running goals.

    Args:
        name: the client's id on the bus.
        rng: draws all requests.
        on_event: called with a sentence for each request.
    """

    def __init__(self, name: str, bus: MemoryBus, rng: Random, on_event: Callable[[str], None]) -> None:
        self._name = name
        self._bus = bus
        self._rng = rng
        self._on_event = on_event
        self._paused: set[str] = set()
        """Ids of the goals that may be paused."""
        self._requests: list[SentRequest] = []

    @property
    def accepted(self) -> Counter[str]:
        """Number of accepted requests by their kind."""
        replies = [reply for request in self._requests for reply in request.replies]
        return Counter(
            pauses=sum(isinstance(reply, PauseReply) and reply.paused for reply in replies),
            resumptions=sum(isinstance(reply, ResumeReply) and reply.resumed for reply in replies),
            changes=sum(isinstance(reply, ModifyReply) and reply.modified for reply in replies),
        )

    def step(self, running: Sequence[SentGoal], *, active: bool) -> None:
        """Send requests about the goals that run; to be called every period.

        Args:
            active: whether goals may be paused and changed; otherwise those that were paused are resumed.
        """
        rng = self._rng
        for sent in running:
            goal_id, action = sent.goal.goal_id, sent.action
            if goal_id in self._paused and (not active or rng.random() < RESUME_PROBABILITY):
                self._request(action.resume, Resume(goal_id=goal_id, issued_t_ns=self._bus.t_ns))
                if rng.random() < 0.5:  # else again, as the request may get lost
                    self._paused.discard(goal_id)
            elif active and rng.random() < PAUSE_PROBABILITY:
                self._paused.add(goal_id)
                self._request(action.pause, Pause(goal_id=goal_id, issued_t_ns=self._bus.t_ns))
            if active and action.changeable and rng.random() < MODIFY_PROBABILITY:
                names = rng.sample(action.changeable, rng.randint(1, min(2, len(action.changeable))))
                fields = {name: FIELD_DRAWS[name](rng) for name in names if name in FIELD_DRAWS}
                self._request(action.modify, Modify(goal_id=goal_id, fields=fields, issued_t_ns=self._bus.t_ns))

    def _request(self, endpoint: Endpoint[Any, Any], payload: Any) -> None:
        self._on_event(f"{self._name} requests {endpoint.name} {msgspec.json.encode(payload).decode()}")
        self._requests.append(self._bus.send_request(endpoint, payload, self._name))


class _Outcome(msgspec.Struct):
    """The field of any action's result that a client needs."""

    outcome: str


class Client:
    """A client that sends goals and requests at random and queries the outcome of its goals.

    Args:
        name: the client's id on the bus.
        bus: the bus of the stack.
        rng: draws everything that the client sends.
        on_event: called with a sentence for each message that it sends.
        pauser: pauses, resumes and modifies its goals.

    Attributes:
        sent: goals sent so far.
        requests: all other requests sent so far.
    """

    def __init__(self, name: str, bus: MemoryBus, rng: Random, on_event: Callable[[str], None], pauser: Pauser) -> None:
        self.name = name
        self.pauser = pauser
        self.sent: list[SentGoal] = []
        self.requests: list[SentRequest] = []
        self._bus = bus
        self._rng = rng
        self._on_event = on_event
        self._next_ns = 0

    def step(self, status: Status | None, *, active: bool) -> None:
        """Continue; to be called every PERIOD_S.

        Args:
            status: the latest status.
            active: whether the client may send new goals and requests.
        """
        for sent in self.sent:
            if not sent.known_outcome:
                self._query_result(sent)
        running = [sent for sent in self.sent if sent.accepted and not sent.known_outcome]
        self.pauser.step(running, active=active)
        if active and status is not None and self._bus.t_ns >= self._next_ns:
            self._next_ns = self._bus.t_ns + int(self._rng.expovariate(1.0 / ACTION_INTERVAL_MEAN_S) * NS_PER_S)
            self._act(status)

    def _query_result(self, sent: SentGoal) -> None:
        """Read the outcome from the goal's own query, else query the action servers for the goal's result."""
        last = [query.replies[-1] if query.replies else None for query in sent.queries]
        if all(isinstance(reply, Rejected) for reply in last):
            sent.known_outcome = "rejected"
        for reply in last:
            if isinstance(reply, Result):
                sent.known_outcome = reply.outcome
        replies = [] if sent.result_query is None else sent.result_query.replies
        if replies and replies[-1].result is not None:
            with suppress(BadPayloadError):  # else another reply has it
                sent.known_outcome = decode(_Outcome, replies[-1].result.encode()).outcome
        if not sent.known_outcome and self._bus.t_ns >= sent.result_queried_ns + int(RESULT_QUERY_PERIOD_S * NS_PER_S):
            sent.result_queried_ns = self._bus.t_ns
            sent.result_query = self._bus.send_request(topics.RESULT, GetResult(goal_id=sent.goal.goal_id), self.name)

    def _act(self, status: Status) -> None:
        rng, code = self._rng, status.code
        if code == StatusCode.IDLE and rng.random() < 0.85:
            self._send(rng.choice((topics.TAKEOFF, topics.TAKEOFF, topics.GO_TO)))
        elif code == StatusCode.HOVER and rng.random() < 0.8:
            self._send(rng.choice([a for a in all_actions().values() if a is not topics.TAKEOFF] + [topics.GO_TO]))
        elif code == StatusCode.EXTERNAL and rng.random() < 0.5:
            self._request(topics.HOVER, Hover())
        elif rng.random() < 0.6:
            self._interfere(status)

    def _interfere(self, status: Status) -> None:
        """Send a request that may not fit the present state."""
        rng = self._rng
        match rng.randrange(7):
            case 0:
                self._request(topics.ABORT, Abort(reason=f"{self.name} says so"))
            case 1:
                self._request(topics.HOVER, Hover())
            case 2:
                point = (rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0), rng.uniform(-5.0, -1.5))
                self._request(topics.HOVER, Hover(hover_pos=point))
            case 3 if self.sent:
                mine = rng.choice(self.sent[-3:])
                self._request(mine.action.cancel, Cancel(goal_id=mine.goal.goal_id))
            case 4 if self.sent:
                self._send_again(rng.choice(self.sent[-2:]))
            case 5:
                self._on_event(f"{self.name} disconnects and connects again")
                self._bus.client_departs(self.name)
            case 6:
                self._request(topics.KILL, Kill(confirm=False))
            case _:
                self._send(rng.choice(tuple(all_actions().values())))

    def _send(self, action: Action[Any]) -> None:
        goal = draw_goal(action, self._rng, f"{self.name}-{len(self.sent) + 1}", self._bus.t_ns)
        sent = SentGoal(goal, action, result_queried_ns=self._bus.t_ns)
        self.sent.append(sent)
        self._on_event(f"{self.name} sends {action.name} {goal.goal_id}")
        sent.queries.append(self._bus.send_request(action.endpoint, goal, self.name))
        if self._rng.random() < 0.15:
            self._send_again(sent)

    def _send_again(self, sent: SentGoal) -> None:
        self._on_event(f"{self.name} sends {sent.goal.goal_id} again")
        sent.known_outcome = "" if sent.known_outcome == "rejected" else sent.known_outcome
        sent.queries.append(self._bus.send_request(sent.action.endpoint, sent.goal, self.name))

    def _request(self, endpoint: Endpoint[Any, Any], payload: Any) -> None:
        self._on_event(f"{self.name} requests {endpoint.name} {msgspec.json.encode(payload).decode()}")
        self.requests.append(self._bus.send_request(endpoint, payload, self.name))
