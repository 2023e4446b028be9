"""Clients that send goals and requests at random, independently of each other."""

from collections.abc import Callable
from contextlib import suppress
from random import Random
from typing import Any

import msgspec

from jezero.codec import BadPayloadError, decode
from jezero.plugins import all_actions
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, GetResult, Rejected, Result
from jezero.schemas.commands import Abort, Hover, Kill
from jezero.schemas.rows import Action, Endpoint
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.pauser import Pauser
from jezero.trials.campaign.sent_goals import SentGoal, draw_goal

PERIOD_S = 0.5
ACTION_INTERVAL_MEAN_S = 3.0
RESULT_QUERY_PERIOD_S = 3.0


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
