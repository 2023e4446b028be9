"""Clients with wishes of their own, who don't ask each other."""

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import msgspec

from jezero.runtime.memory_bus import Answers, MemoryBus
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, GetResult, Goal, Rejected, Result
from jezero.schemas.commands import Abort, Hover, Kill
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.units import NS_PER_S

PERIOD_S = 0.5
WISH_EVERY_S = 3.0
ASK_AGAIN_S = 3.0

FIELDS: dict[str, Callable[[Random], Any]] = {
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
"""What clients put into the fields of a goal, whichever action has them; other fields keep their defaults."""


def draw_goal(action: topics.Action[Any], rng: Random, goal_id: str, t_ns: int) -> Goal:
    """A goal whose numbers are possible, whether or not the vehicle, the rover and its estimate are ready for it.

    Raises:
        KeyError: the action's goal has a field without a default that FIELDS doesn't know.
    """
    values: dict[str, Any] = {"goal_id": goal_id, "issued_t_ns": t_ns}
    for info in msgspec.structs.fields(action.goal_type):
        if info.name in FIELDS:
            values[info.name] = FIELDS[info.name](rng)
        elif info.required and info.name not in values:
            raise KeyError(f"the campaign's clients don't know what to put into {info.name} of {action.name}")
    goal: Goal = action.goal_type(**values)
    return goal


@dataclass
class Sent:
    """A goal that a client sent, and what it knows of it.

    Attributes:
        learned: the outcome, "rejected", or "" as long as it knows none.
    """

    goal: Goal
    action: topics.Action[Any]
    answers: list[Answers] = field(default_factory=list)
    asked: Answers | None = None
    asked_ns: int = 0
    learned: str = ""

    @property
    def accepted(self) -> bool:
        return any(isinstance(reply, Accepted) for answers in self.answers for reply in answers.replies)


class Client:
    """Somebody who wants things, and wants to know what became of them.

    Args:
        tell: called with a sentence on everything it does.
    """

    def __init__(self, name: str, bus: MemoryBus, rng: Random, tell: Callable[[str], None]) -> None:
        self.name = name
        self.sent: list[Sent] = []
        self.asked: list[Answers] = []
        self._bus = bus
        self._rng = rng
        self._tell = tell
        self._next_ns = 0

    def step(self, status: Status | None, *, wishes: bool) -> None:
        """To be called every PERIOD_S.

        Args:
            wishes: whether it may wish for something new.
        """
        for sent in self.sent:
            if not sent.learned:
                self._inquire(sent)
        if wishes and status is not None and self._bus.t_ns >= self._next_ns:
            self._next_ns = self._bus.t_ns + int(self._rng.expovariate(1.0 / WISH_EVERY_S) * NS_PER_S)
            self._wish(status)

    def _inquire(self, sent: Sent) -> None:
        """From its own query; else from whoever knows the goal's result."""
        last = [answers.replies[-1] if answers.replies else None for answers in sent.answers]
        if all(isinstance(reply, Rejected) for reply in last):
            sent.learned = "rejected"
        for reply in last:
            if isinstance(reply, Result):
                sent.learned = reply.outcome
        if sent.asked is not None and sent.asked.replies and sent.asked.replies[-1].result is not None:
            sent.learned = msgspec.json.decode(sent.asked.replies[-1].result)["outcome"]
        if not sent.learned and self._bus.t_ns >= sent.asked_ns + int(ASK_AGAIN_S * NS_PER_S):
            sent.asked_ns = self._bus.t_ns
            sent.asked = self._bus.ask(topics.RESULT, GetResult(goal_id=sent.goal.goal_id), self.name)

    # -- wishes --

    def _wish(self, status: Status) -> None:
        rng, code = self._rng, status.code
        if code == StatusCode.IDLE and rng.random() < 0.85:
            self._send(rng.choice((topics.TAKEOFF, topics.TAKEOFF, topics.GO_TO)))
        elif code == StatusCode.HOVER and rng.random() < 0.8:
            self._send(rng.choice([a for a in topics.ACTIONS.values() if a is not topics.TAKEOFF] + [topics.GO_TO]))
        elif code == StatusCode.EXTERNAL and rng.random() < 0.5:
            self._ask(topics.HOVER, Hover())
        elif rng.random() < 0.6:
            self._interfere(status)

    def _interfere(self, status: Status) -> None:
        """Something that may well not fit what is going on."""
        rng = self._rng
        match rng.randrange(7):
            case 0:
                self._ask(topics.ABORT, Abort(reason=f"{self.name} says so"))
            case 1:
                self._ask(topics.HOVER, Hover())
            case 2:
                point = (rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0), rng.uniform(-5.0, -1.5))
                self._ask(topics.HOVER, Hover(hover_pos=point))
            case 3 if self.sent:
                mine = rng.choice(self.sent[-3:])
                self._ask(mine.action.cancel, Cancel(goal_id=mine.goal.goal_id))
            case 4 if self.sent:
                self._send_again(rng.choice(self.sent[-2:]))
            case 5:
                self._tell(f"{self.name} vanishes and comes back")
                self._bus.client_departs(self.name)
            case 6:
                self._ask(topics.KILL, Kill(confirm=False))
            case _:
                self._send(rng.choice(tuple(topics.ACTIONS.values())))

    def _send(self, action: topics.Action[Any]) -> None:
        goal = draw_goal(action, self._rng, f"{self.name}-{len(self.sent) + 1}", self._bus.t_ns)
        sent = Sent(goal, action, asked_ns=self._bus.t_ns)
        self.sent.append(sent)
        self._tell(f"{self.name} sends {action.name} {goal.goal_id}")
        sent.answers.append(self._bus.ask(action.endpoint, goal, self.name))
        if self._rng.random() < 0.15:
            self._send_again(sent)

    def _send_again(self, sent: Sent) -> None:
        self._tell(f"{self.name} sends {sent.goal.goal_id} again")
        sent.learned = "" if sent.learned == "rejected" else sent.learned
        sent.answers.append(self._bus.ask(sent.action.endpoint, sent.goal, self.name))

    def _ask(self, endpoint: topics.Endpoint[Any, Any], payload: Any) -> None:
        self._tell(f"{self.name} asks {endpoint.name} {msgspec.json.encode(payload).decode()}")
        self.asked.append(self._bus.ask(endpoint, payload, self.name))
