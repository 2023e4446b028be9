"""The mission service: flies the steps of a mission one after the other, whoever sent it, and gives way to people.

running -> succeeded, failed or stopped; running <-> paused by commands. When a person requests a hover or an abort,
cancels a goal or takes control, when a failsafe does, and after a restart of this service or of the vehicle, the
mission is interrupted: it does nothing until a person commands `resume`, `skip` or `stop`.
"""

from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from jezero.runtime.service import Health, Inbox, Output, Publish, Reply, Request, Spec
from jezero.schemas.mission import GoalStep, Mission, MissionCommand, MissionProgress, MissionReply, WaitStep
from jezero.schemas.state import Status
from jezero.schemas.topics import CLOCK, COMMAND_MISSION, MISSION, RESULT, RUN_MISSION, STATUS, Action
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.step_run import GoalRun, StepEnd, Wait, goal_of

PUBLISH_PERIOD_NS = NS_PER_S // 2
LAND_ON_SPOT = "land_on_spot"
PAUSED = "paused by a command"
RESTARTED = "the mission service was restarted"
REQUESTED = "a hover, an abort or a kill was requested"
VEHICLE_RESTARTED = "the vehicle was restarted"
NO_MISSION = "no mission is flown: send one with jezero mission run FILE"
Wanted = Literal["", "hold", "skip", "stop"]
"""Next action of the service, once the goal that it has canceled has ended; "" for none."""
ENDING = "the goal of the present step is still ending: try again in a second"


class MissionService:
    """The service.

    Args:
        boot_id: differs between two runs, so that ids of missions do too.
        actions: every action by name.
        saved: the mission of the run before this one; None: there was none.
        save: keeps a mission over a restart.
    """

    def __init__(
        self,
        boot_id: int,
        actions: Mapping[str, Action[Any]],
        saved: MissionRecord | None = None,
        save: Callable[[MissionRecord], None] = lambda record: None,
    ) -> None:
        self._boot_id = boot_id
        self._actions = actions
        self._save = save
        self._missions = 0
        self._run: GoalRun | Wait | None = None
        self._wanted: Wanted = ""
        self._pauses: list[int] = []
        """Ids of the requests for a pause that wait for the action server."""
        self._interventions: tuple[int, int] | None = None
        """Bridge's boot id, and the number of interventions, when the mission began or went on."""
        self._published_ns: int | None = None
        self._health: Health | None = None
        self._record = saved
        if saved is not None and not saved.ended:
            self._record = saved.in_state("interrupted", RESTARTED)
        calls = [
            endpoint
            for action in actions.values()
            for endpoint in (action.endpoint, action.cancel, action.pause, action.resume)
        ]
        self.spec = Spec(
            name="mission",
            inputs=(STATUS, CLOCK),
            outputs=(MISSION,),
            last_value=(MISSION,),
            serves=(RUN_MISSION, COMMAND_MISSION),
            calls=(RESULT, *calls),
            triggers=(RUN_MISSION.name, COMMAND_MISSION.name),
            rate_hz=10.0,
            made_with={"boot_id": boot_id, "saved": saved},
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the mission, then handle the requests that arrived."""
        before = self._record
        yield from self._watch_epoch(inbox)
        yield from self._watch_interventions(inbox)
        yield from self._advance(t_ns, inbox)
        for request in inbox.requests(RUN_MISSION):
            yield self._begin(request)
        for request in inbox.requests(COMMAND_MISSION):
            yield from self._command(request)
        if self._record is not None and self._record is not before:
            self._save(self._record)
        yield from self._publish(t_ns, changed=self._record is not before)

    # -- flying --

    def _watch_epoch(self, inbox: Inbox) -> Iterator[Output]:
        """Interrupt the mission when the vehicle was restarted."""
        clock, record = inbox.latest(CLOCK), self._record
        if clock is None or record is None or record.ended or clock.epoch_id == record.epoch_id:
            return
        self._record = replace(record, epoch_id=clock.epoch_id)
        if record.epoch_id:
            self._run, self._wanted = None, ""
            self._record = self._record.next_attempt(None).in_state("interrupted", VEHICLE_RESTARTED)
            yield from self._reply_to_pauses(VEHICLE_RESTARTED, record)

    def _watch_interventions(self, inbox: Inbox) -> Iterator[Output]:
        """Interrupt the mission when a person or a failsafe has intervened since it began or went on."""
        status, record = inbox.latest(STATUS), self._record
        if status is None or record is None or record.state not in ("running", "paused"):
            return
        present = (status.bridge_boot_id, status.interventions)
        if self._interventions is None:
            self._interventions = present
        external = status.in_charge in ("external", "failsafe")
        if present == self._interventions and not external:
            return
        yield from self._hold(
            record.in_state("interrupted", status.text if external else f"{REQUESTED}: {status.text}")
        )

    def _hold(self, held: MissionRecord) -> Iterator[Output]:
        """Stop flying, and wait for a command."""
        self._record = held
        if isinstance(self._run, GoalRun):
            self._wanted = "stop" if self._wanted == "stop" else "hold"
            yield from self._run.cancel()

    def _advance(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the present step, and begin the next one when it has ended."""
        record, run = self._record, self._run
        if record is None:
            return
        if run is not None:
            yield from run.step(t_ns, inbox, paused=record.state != "running")
            if isinstance(run, GoalRun) and (reply := run.pause_reply(inbox)) is not None:
                yield from self._reply_to_pauses(reply.reason, record)
            if run.ended is None:
                return
            self._run = None
            self._record = self._after(self._record or record, run.ended, inbox.latest(STATUS))
            yield from self._reply_to_pauses("the step has ended", record)
        if self._record is not None and self._record.state == "running":
            yield from self._begin_step(t_ns, self._record, inbox)

    def _begin_step(self, t_ns: int, record: MissionRecord, inbox: Inbox) -> Iterator[Output]:
        step, status = record.step, inbox.latest(STATUS)
        if status is None:
            return
        if reason := _somebody_else(status, record.mission_id):
            self._record = record.in_state("interrupted", reason)
            return
        if isinstance(step, WaitStep):
            self._run = Wait(t_ns, step.duration_s)
        else:
            action, fields = self._actions[step.action], step.goal if record.rest is None else record.rest
            self._run = GoalRun(action, goal_of(action, fields, record.goal_id, t_ns))
        yield from self._run.step(t_ns, inbox, paused=False)

    def _after(self, record: MissionRecord, end: StepEnd, status: Status | None) -> MissionRecord:
        """The mission after the end of a try."""
        wanted, self._wanted = self._wanted, ""
        if wanted == "stop":
            return record.in_state("stopped", "stopped by a command")
        if wanted == "skip":
            return record.next_step()
        following = record.next_step() if end.end == "succeeded" else record.next_attempt(end.rest)
        if wanted == "hold":
            return following if following.ended else following.in_state(record.state, record.reason)
        if end.end == "succeeded":
            return following
        if end.end == "canceled":
            return following.in_state("interrupted", f"{record.step.label}: {end.reason}")
        return self._after_failure(record, end, status)

    def _after_failure(self, record: MissionRecord, end: StepEnd, status: Status | None) -> MissionRecord:
        """The mission after a failed try, by the step's policy."""
        reason = f"step {record.index + 1}, {record.step.label}: {end.reason}"
        if record.last is not None:
            return record.in_state("failed", f"{record.reason}; then {record.last.label}: {end.reason}")
        policy, failures = record.policy, record.failures + 1
        record = record.in_state("running")
        if failures <= policy.retries:
            return replace(record.next_attempt(end.rest), failures=failures, reason=f"tried again: {end.reason}")
        if policy.then == "skip":
            return replace(record.next_step(), reason=f"left out {reason}")
        if policy.then == "stop" or status is None or status.odometry is None or status.landed:
            return record.in_state("failed", end.reason)
        return replace(record, last=_last_goal(policy.then, status), attempt=1, rest=None, reason=reason)

    # -- requests --

    def _begin(self, request: Request) -> Reply:
        mission: Mission = request.payload
        present = self._record
        if present is not None and not present.ended:
            reason = f"the mission {present.mission.name!r} is {present.state}: end it first (jezero mission stop)"
            return Reply(request.request_id, MissionReply(accepted=False, reason=reason))
        if problem := self._problem(mission):
            return Reply(request.request_id, MissionReply(accepted=False, reason=problem))
        self._missions += 1
        mission_id = f"mission-{self._boot_id:x}-{self._missions}"
        self._record = MissionRecord(mission=mission, mission_id=mission_id)
        self._interventions = None
        return Reply(request.request_id, MissionReply(accepted=True, mission_id=mission_id))

    def _problem(self, mission: Mission) -> str:
        """The first mistake in a mission's goals, or ""."""
        for number, step in enumerate(mission.steps, start=1):
            if not isinstance(step, GoalStep):
                continue
            action = self._actions.get(step.action)
            if action is None:
                known = ", ".join(self._actions)
                return f"step {number}: there is no action {step.action!r}; the actions are {known}"
            try:
                goal_of(action, step.goal, "check", 0)
            except msgspec.ValidationError as error:
                return f"step {number}, {step.label}: {error}"
        return ""

    def _command(self, request: Request) -> Iterator[Output]:
        command: MissionCommand = request.payload
        record = self._record
        refusal = NO_MISSION
        if record is not None and not record.ended:
            if command.command == "pause" and record.state == "running" and isinstance(self._run, GoalRun):
                self._pauses.append(request.request_id)
                yield from self._run.pause()
                return
            refusal = yield from self._carry_out(command.command, record)
        mission_id = "" if record is None else record.mission_id
        yield Reply(request.request_id, MissionReply(accepted=not refusal, reason=refusal, mission_id=mission_id))

    def _reply_to_pauses(self, refusal: str, record: MissionRecord) -> Iterator[Output]:
        """Reply to the requests for a pause.

        Args:
            refusal: reason why the goal isn't paused, or "".
        """
        if self._pauses and not refusal:
            self._record = record.in_state("paused", PAUSED)
        for request_id in self._pauses:
            reply = MissionReply(accepted=not refusal, reason=refusal, mission_id=record.mission_id)
            yield Reply(request_id, reply)
        self._pauses.clear()

    def _carry_out(self, command: str, record: MissionRecord) -> Generator[Output, None, str]:
        """Carry out a command; returns the reason of a refusal, or ""."""
        run = self._run
        waits = record.state in ("paused", "interrupted")
        if command == "resume" and not waits:
            return "the mission is running"
        if command == "pause" and waits:
            return f"the mission is {record.state} already"
        if command == "resume":
            if self._wanted:
                return ENDING
            self._interventions = None
            self._record = record.in_state("running")
            if isinstance(run, GoalRun):
                yield from run.resume()
        elif command == "pause":
            self._record = record.in_state("paused", PAUSED)
        else:
            self._interventions = None
            self._wanted = "skip" if command == "skip" else "stop"
            if run is not None:
                yield from run.cancel()
            else:
                self._record = self._after(record, StepEnd("canceled"), None)
        return ""

    # -- outputs --

    def _publish(self, t_ns: int, *, changed: bool) -> Iterator[Output]:
        due = self._published_ns is None or t_ns - self._published_ns >= PUBLISH_PERIOD_NS
        if not (due or changed):
            return
        self._published_ns = t_ns
        record, goal_id = self._record, "" if self._run is None else self._run.goal_id
        yield Publish(
            MISSION, MissionProgress(t_ns=t_ns, state="idle") if record is None else record.message(t_ns, goal_id)
        )
        health = Health("ok", "no mission" if record is None else f"{record.mission.name}: {record.state}")
        if health != self._health:
            self._health = health
            yield health


def _somebody_else(status: Status, mission_id: str) -> str:
    """Who else than the mission has control, or ""."""
    if status.in_charge in ("external", "failsafe"):
        return f"somebody else has control: {status.text}"
    if status.in_charge == "goal" and not status.goal_id.startswith(f"{mission_id}."):
        return f"goal {status.goal_id} of another client is in charge"
    return ""


def _last_goal(then: str, status: Status) -> GoalStep:
    """The goal that ends a mission after a failure."""
    if then == "return":
        return GoalStep(label="land on the rover", action=LAND_ON_SPOT, goal={})
    assert status.odometry is not None
    north_m, east_m, _ = status.odometry.pos_uav_ned_m
    goal = {"landing_spot_ned_m": [north_m, east_m, 0.0], "use_uwb": False, "use_tag": False}
    return GoalStep(label="land here", action=LAND_ON_SPOT, goal=goal)
