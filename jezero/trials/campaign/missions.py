"""Missions drawn at random, the client that sends and commands them, and their judge.

The judge checks that missions go forward, end as their file says, and stay away from whoever took control.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import msgspec

from jezero.base.plugins import all_actions
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, Request, Service
from jezero.schemas import topics
from jezero.schemas.commands import Abort, Hover
from jezero.schemas.goals import Goal
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
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.clients import draw_goal
from jezero.trials.campaign.judge import Judge

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


# -- the judge -------------------------------------------------------------------------------------------

LAST_ACTIONS = {"return": topics.RETURN_HOME.name, "land": topics.LAND_ON_SPOT.name}
"""Action of the goal that ends a mission after a failure, by the step's policy."""
OUTLIVES_MAX_NS = 5 * NS_PER_S
"""A goal is over this long after its mission at the latest."""
FORWARD = "a mission only goes forward"
END = "a mission ends as its file says"
STOPPED = "no goal of a mission after its end"
AWAY = "no goal of a mission after a takeover, until a command"


class MissionLog:
    """What all runs of the mission service did with one mission.

    Attributes:
        mission: the mission.
        place: step, whether the goal that ends the mission flies, and attempt, of the last progress.
        state: state of the last progress.
        stopped: somebody commanded `stop`, and it was accepted.
        last_action: action of the goal that was sent to end the mission; "" for none.
        takeoff_step: number of the last step that a takeoff was sent for, of a mission held before; 0 for none.
        bridge: bridge's boot id and number of interventions since which the mission flies; None while it is unknown.
        held: somebody took control, and nobody has commanded anything since.
        ended_ns: time of the mission's end.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.place = (1, False, 1)
        self.state = "running"
        self.stopped = False
        self.last_action = ""
        self.takeoff_step = 0
        self.bridge: tuple[int, int] | None = None
        self.held = False
        self.ended_ns = 0


class MissionJudge:
    """Service that runs the mission service and checks its goals and its progress.

    Args:
        service: the mission service.
        judge: collects the violations.
        logs: of each mission by its id, of all runs of the service; added to.
        goals: goals of missions by their ids; added to.
    """

    def __init__(self, service: Service, judge: Judge, logs: dict[str, MissionLog], goals: dict[str, Goal]) -> None:
        self.spec = service.spec
        self._service = service
        self._judge = judge
        self._logs = logs
        self._goals = goals
        self._requests: dict[int, Request] = {}
        """Requests for missions and commands that wait for a reply."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """See `Service`."""
        for endpoint in (topics.RUN_MISSION, topics.COMMAND_MISSION):
            self._requests.update({request.request_id: request for request in inbox.requests(endpoint)})
        status = inbox.latest(topics.STATUS)
        if status is not None:
            self._on_status(t_ns, status)
        for output in self._service.step(t_ns, inbox):
            if isinstance(output, Reply) and isinstance(output.payload, MissionReply):
                self._on_reply(self._requests.pop(output.request_id).payload, output.payload)
            elif isinstance(output, Call) and isinstance(output.payload, Goal):
                self._on_goal(t_ns, output.payload, output.endpoint.name, status)
            elif isinstance(output, Publish) and isinstance(output.message, MissionProgress):
                self._on_progress(t_ns, output.message, status)
            yield output

    def _on_status(self, t_ns: int, status: Status) -> None:
        """Notice whoever takes control from a mission that flies, and a goal that outlives its mission."""
        present = (status.bridge_boot_id, status.interventions)
        for mission_id, log in self._logs.items():
            if log.state in ENDS:
                outlives = status.goal_id.startswith(f"{mission_id}.") and status.t_ns - log.ended_ns > OUTLIVES_MAX_NS
                self._judge.check(not outlives, t_ns, STOPPED, f"{status.goal_id} flies, the mission: {log.state}")
            if log.state in ENDS or log.held:
                continue
            log.bridge = log.bridge or present
            log.held = present != log.bridge or status.in_charge in ("external", "failsafe")

    def _on_reply(self, request: Mission | MissionCommand, reply: MissionReply) -> None:
        if not reply.accepted:
            return
        if isinstance(request, Mission):
            self._logs[reply.mission_id] = MissionLog(request)
            return
        log = self._logs[reply.mission_id]
        if request.command == "stop":
            log.stopped = True
        elif request.command != "pause":
            log.held, log.bridge = False, None

    def _on_goal(self, t_ns: int, goal: Goal, endpoint: str, status: Status | None) -> None:
        log = self._logs.get(goal.goal_id.partition(".")[0])
        if log is None or goal.goal_id.endswith("/plan"):
            return
        self._goals[goal.goal_id] = goal
        self._judge.check(
            log.state not in ENDS and not log.stopped,
            t_ns,
            STOPPED,
            f"{goal.goal_id} is sent, the mission: {log.state}",
        )
        text = "without a status" if status is None else f"in status {status.name}: {status.text}"
        free = status is not None and not log.held
        self._judge.check(free, t_ns, AWAY, f"{goal.goal_id} is sent {text}")
        place = goal.goal_id.split(".")[1]
        if goal.goal_id.endswith(".takeoff"):
            log.takeoff_step = 0 if place == "end" else int(place)
        if place == "end":
            log.last_action = next(name for name in LAST_ACTIONS.values() if f"/{name}/" in f"/{endpoint}/")

    def _on_progress(self, t_ns: int, progress: MissionProgress, status: Status | None) -> None:
        log = self._logs.get(progress.mission_id)
        if log is None:
            return
        step = log.mission.steps[progress.step - 1]
        place = (progress.step, progress.label != step.label, progress.attempt)
        text = f"{progress.mission_id} from {log.place} {log.state} to {place} {progress.state}: {progress.reason}"
        self._judge.check(place >= log.place, t_ns, FORWARD, text)
        self._judge.check(log.state not in ENDS or progress.state == log.state, t_ns, FORWARD, text)
        if progress.state in ENDS and log.state not in ENDS:
            log.place, log.state, log.ended_ns = place, progress.state, t_ns
            cannot_fly = status is None or status.landed or status.odometry is None
            self._judge.check(_ends_rightly(log, step, cannot_fly=cannot_fly), t_ns, END, text)
            says_why = progress.state != "failed" or bool(progress.reason.partition("; then")[0])
            self._judge.check(says_why, t_ns, "a mission that fails says why", text)
        log.place, log.state = place, progress.state


def _ends_rightly(log: MissionLog, step: Any, *, cannot_fly: bool) -> bool:
    """Whether the mission may be in its end, by its last step.

    Args:
        cannot_fly: the vehicle stands on the ground or its position is unknown, so that no goal can bring it home.
    """
    number, _, _ = log.place
    if log.state == "stopped":
        return log.stopped
    if log.state == "succeeded":
        return number == len(log.mission.steps)
    if not isinstance(step, GoalStep):  # a wait can't fail, but a takeoff before it can, which stops the mission
        return log.takeoff_step == number
    if step.on_failure.then == "skip":
        return False
    return cannot_fly or LAST_ACTIONS.get(step.on_failure.then, "") == log.last_action
