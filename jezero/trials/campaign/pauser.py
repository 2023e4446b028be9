"""Pauses, resumptions and changes of one client's goals, at random."""

from collections import Counter
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

import msgspec

from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas.actions import Modify, ModifyReply, Pause, PauseReply, Resume, ResumeReply
from jezero.schemas.rows import Endpoint
from jezero.trials.campaign.sent_goals import FIELD_DRAWS, SentGoal

PAUSE_PROBABILITY, RESUME_PROBABILITY, MODIFY_PROBABILITY = 0.12, 0.3, 0.06
"""Probabilities that a request is sent in one period, while a goal is flown or paused."""


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
