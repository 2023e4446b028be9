"""Missions drawn at random, and the client that sends them and commands them."""

from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Any

import msgspec

from jezero.plugins import all_actions
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.commands import Abort, Hover
from jezero.schemas.mission import (
    FailurePolicy,
    GoalStep,
    Mission,
    MissionCommand,
    MissionProgress,
    MissionReply,
    MissionState,
    Step,
    WaitStep,
)
from jezero.schemas.rows import Endpoint
from jezero.schemas.state import Status, StatusCode
from jezero.trials.campaign.sent_goals import draw_goal

MISSION_PROBABILITY = 1.0 / 4.0
"""Share of the seeds in which a client sends missions, and nobody single goals."""
CLIENT = "alice"
ENDS: frozenset[MissionState] = frozenset({"idle", "succeeded", "failed", "stopped"})
COMMANDS: dict[MissionState, tuple[str, ...]] = {
    "running": ("pause", "pause", "pause", "skip", "skip", "stop", "resume"),
    "paused": ("resume", "resume", "resume", "skip", "stop", "pause"),
    "interrupted": ("resume", "resume", "resume", "skip", "stop", "swapped"),
}
"""Commands by the mission's state; the more often they occur, the more often they are sent."""
COMMAND_PROBABILITY: dict[MissionState, float] = {"running": 0.05, "paused": 0.3, "interrupted": 0.3}
"""Probabilities that a command is sent in one period."""
INTERVENTION_PROBABILITY = 0.015
"""Probability that somebody requests a hover or an abort in one period."""


class MissionClient:
    """Sends one mission after the other, and at random commands, hovers and aborts.

    Args:
        bus: the bus of the stack.
        rng: draws everything.
        on_event: called with a sentence for each request.
    """

    def __init__(self, bus: MemoryBus, rng: Random, on_event: Callable[[str], None]) -> None:
        self._bus = bus
        self._rng = rng
        self._on_event = on_event
        self._progress: MissionProgress | None = None
        self._decoder = msgspec.json.Decoder(MissionProgress)
        self._missions: list[SentRequest] = []
        self._commands: list[SentRequest] = []
        bus.observe(self._observe)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.MISSION.name:
            self._progress = self._decoder.decode(data)

    @property
    def waits(self) -> bool:
        """Whether no mission flies: it is over, or waits for a person."""
        return self._progress is None or self._progress.state != "running"

    @property
    def accepted(self) -> Counter[str]:
        """Number of accepted missions and commands."""

        def count(requests: list[SentRequest]) -> int:
            replies = [reply for request in requests for reply in request.replies]
            return sum(isinstance(reply, MissionReply) and reply.accepted for reply in replies)

        return Counter({"missions": count(self._missions), "commands to missions": count(self._commands)})

    def step(self, status: Status | None, *, active: bool) -> None:
        """Continue; to be called every period.

        Args:
            status: the latest status.
            active: whether missions may be sent; otherwise the present one is stopped.
        """
        rng, state = self._rng, "idle" if self._progress is None else self._progress.state
        if not active:
            if state not in ENDS:
                self._command("stop")
            return
        if status is not None and rng.random() < INTERVENTION_PROBABILITY:
            self._intervene()
        if state in ENDS and status is not None and rng.random() < 0.5:
            mission = draw_mission(rng, self._bus.t_ns, from_ground=status.code == StatusCode.IDLE)
            self._missions.append(self._request(topics.RUN_MISSION, mission))
        elif state not in ENDS and rng.random() < COMMAND_PROBABILITY[state]:
            self._command(rng.choice(COMMANDS[state]))

    def _intervene(self) -> None:
        if self._rng.random() < 0.5:
            self._request(topics.ABORT, Abort(reason="a bird"))
        else:
            self._request(topics.HOVER, Hover())

    def _command(self, command: Any) -> None:
        self._commands.append(self._request(topics.COMMAND_MISSION, MissionCommand(command=command)))

    def _request(self, endpoint: Endpoint[Any, Any], payload: Any) -> SentRequest:
        self._on_event(f"{CLIENT} requests {endpoint.name} {msgspec.json.encode(payload).decode()}")
        return self._bus.send_request(endpoint, payload, CLIENT)


def draw_mission(rng: Random, t_ns: int, *, from_ground: bool) -> Mission:
    """Draw a mission of few steps.

    Args:
        from_ground: the vehicle stands, so that the mission mostly begins with a takeoff.
    """
    middle = ("go_to", "go_to", "go_to", "wait", "get_images", "area_coverage")
    names = ["takeoff"] if from_ground and rng.random() < 0.9 else []
    names += [rng.choice(middle) for _ in range(rng.randint(1, 4))]
    names += rng.choice(([], ["return_home"], ["land_on_spot"]))
    steps = tuple(_draw_step(rng, f"{number} {name}", name, t_ns) for number, name in enumerate(names, start=1))
    return Mission(name="drawn", steps=steps)


def _draw_step(rng: Random, label: str, name: str, t_ns: int) -> Step:
    if name == "wait":
        return WaitStep(label=label, duration_s=rng.uniform(0.0, 6.0))
    fields = msgspec.to_builtins(draw_goal(all_actions()[name], rng, "drawn", t_ns))
    goal = {field: value for field, value in fields.items() if field not in ("goal_id", "issued_t_ns", "do_takeoff")}
    policy = FailurePolicy(
        retries=rng.choice((0, 0, 1, 2)), then=rng.choice(("stop", "skip", "skip", "return", "land"))
    )
    return GoalStep(label=label, action=name, goal=goal, on_failure=policy)
