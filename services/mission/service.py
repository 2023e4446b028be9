"""The mission service: flies the steps of a mission one after the other, whoever sent it, and gives way to people.

running -> succeeded, failed or stopped; running <-> paused by commands. When a person requests a hover or an abort,
cancels a goal or takes control, when a failsafe does, and after a restart of this service or of the vehicle, the
mission is interrupted: it does nothing until a person commands `resume`, `swapped`, `skip` or `stop`.

Whatever flies, a mission or any client's goal, the service also flies the vehicle home when the battery is just enough
for it, or when the ground station is lost. The mission goes on by command, after a takeoff, with what is still missing.
"""

from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from jezero.base.frames import altitude_m
from jezero.base.mistakes import mistake, unknown
from jezero.base.plugins import all_actions
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Reply, Request, Spec
from jezero.schemas.mission import GoalStep, Mission, MissionCommand, MissionProgress, MissionReply, WaitStep
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.struct import TEXT_MAX
from jezero.schemas.topics import (
    ABORT,
    CLOCK,
    COMMAND_MISSION,
    MISSION,
    RESULT,
    RETURN_HOME,
    RUN_MISSION,
    STATUS,
    TAKEOFF,
)
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.config import MissionConfig
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.return_run import ReturnRun
from jezero.services.mission.return_watch import GROUND, ReturnWatch
from jezero.services.mission.rules import flies_goal_of, landing_step, last_goal, somebody_else, swap_refusal
from jezero.services.mission.step_run import StepEnd, StepGoal, Wait, goal_of

PUBLISH_PERIOD_NS = NS_PER_S // 2
PAUSED = "paused by a command"
RESTARTED = "the mission service was restarted"
REQUESTED = "a hover, an abort or a kill was requested"
BRIDGE_RESTARTED = "the vehicle bridge was restarted"
VEHICLE_RESTARTED = "the vehicle was restarted"
NO_MISSION = "no mission is flown: send one with jezero mission run FILE"
Wanted = Literal["", "hold", "skip", "skip and hold", "stop"]
"""Next action of the service, once the goal that it has canceled has ended; "" for none."""
HELD: dict[Wanted, Wanted] = {
    "": "hold", "hold": "hold", "skip": "skip and hold", "skip and hold": "skip and hold", "stop": "stop",
}  # fmt: skip
"""The next action when somebody intervenes before it: a command that was accepted is still carried out."""
ENDING = "the goal of the present step is still ending: try again in a second"
ALTITUDE_MIN_M = 2.0
"""Least altitude of a takeoff before a mission goes on."""


class MissionService:
    """The service.

    Args:
        boot_id: differs between two runs, so that ids of missions do too.
        actions: every action by name; None stands for all that are installed.
        saved: the mission of the run before this one; None: there was none.
        save: keeps a mission over a restart.
        config: settings; like the next, None stands for the defaults.
        vehicle: the vehicle itself.
    """

    def __init__(
        self,
        boot_id: int,
        actions: Mapping[str, Action[Any]] | None = None,
        saved: MissionRecord | None = None,
        save: Callable[[MissionRecord], None] = lambda record: None,
        *,
        config: MissionConfig | None = None,
        vehicle: VehicleConfig | None = None,
    ) -> None:
        actions = all_actions() if actions is None else actions
        config, vehicle = config or MissionConfig(), vehicle or VehicleConfig()
        self._boot_id = boot_id
        self._actions = actions
        self._save = save
        self._missions = 0
        self._run: StepGoal | Wait | None = None
        self._wanted: Wanted = ""
        self._pauses: list[int] = []
        """Ids of the requests for a pause that wait for the action server."""
        self._interventions: tuple[int, int] | None = None
        """Bridge's boot id, and the number of interventions, when the mission began or went on."""
        self._altitude_max_m = vehicle.limits.altitude_max_m
        self._watch = ReturnWatch(config, vehicle.battery)
        self._return: ReturnRun | None = None
        self._returns = 0
        self._takes_off = False
        """The goal that flies is a takeoff before the step."""
        self._published_ns: int | None = None
        self._health: Health | None = None
        self._record = saved
        if saved is not None and saved.state in ("running", "paused"):
            self._record = saved.in_state("interrupted", RESTARTED)
        calls = [
            endpoint
            for action in actions.values()
            for endpoint in (action.endpoint, action.cancel, action.pause, action.resume)
        ]
        self.spec = Spec(
            name="mission",
            inputs=(STATUS, CLOCK, *((GROUND,) if config.ground_loss_s else ())),
            outputs=(MISSION,),
            last_value=(MISSION,),
            serves=(RUN_MISSION, COMMAND_MISSION),
            calls=(RESULT, ABORT, RETURN_HOME.plan, *calls),
            triggers=(RUN_MISSION.name, COMMAND_MISSION.name),
            rate_hz=10.0,
            made_with={"boot_id": boot_id, "saved": saved, "config": config, "vehicle": vehicle},
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the mission, then handle the requests that arrived."""
        before = self._record
        yield from self._watch_epoch(inbox)
        yield from self._watch_interventions(inbox)
        yield from self._watch_way_home(t_ns, inbox)
        yield from self._advance(t_ns, inbox)
        for request in inbox.requests(RUN_MISSION):
            yield self._begin(request, inbox.latest(STATUS))
        for request in inbox.requests(COMMAND_MISSION):
            yield from self._command(request, inbox)
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
            self._run = None
            after = self._after(self._record, StepEnd("canceled", VEHICLE_RESTARTED), inbox.latest(STATUS))
            self._record = after if after.ended else after.in_state("interrupted", VEHICLE_RESTARTED)
            yield from self._reply_to_pauses(VEHICLE_RESTARTED, record)

    def _watch_interventions(self, inbox: Inbox) -> Iterator[Output]:
        """Interrupt the mission when a person or a failsafe has intervened since it began or went on."""
        status, record = inbox.latest(STATUS), self._record
        if status is None or record is None or record.state not in ("running", "paused"):
            return
        present = _interventions_of(status)
        before = self._interventions = self._interventions or present
        external = status.in_charge in ("external", "failsafe")
        if present == before and not external:
            return
        restarted = before is not None and before[0] != status.bridge_boot_id
        event = BRIDGE_RESTARTED if restarted else REQUESTED
        yield from self._hold(
            record.in_state("interrupted", status.text if external else f"{event}: {status.text}"), status
        )

    def _hold(self, held: MissionRecord, status: Status) -> Iterator[Output]:
        """Stop flying, and wait for a command."""
        self._record = self._with_altitude(held, status)
        if isinstance(self._run, StepGoal):
            self._wanted = HELD[self._wanted]
            yield from self._run.cancel()
        elif self._run is not None:
            self._record, self._run = replace(self._record, rest={"duration_s": self._run.left_s}), None

    def _with_altitude(self, record: MissionRecord, status: Status) -> MissionRecord:
        """The mission with the altitude of a takeoff, should the vehicle land before the mission goes on."""
        if status.landed or status.odometry is None:
            return record
        height_m = max(altitude_m(status.odometry.pos_uav_ned_m[2]), ALTITUDE_MIN_M)
        return replace(record, altitude_m=min(height_m, self._altitude_max_m))

    def _watch_way_home(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Fly home when the vehicle must."""
        status, record = inbox.latest(STATUS), self._record
        if self._return is not None:
            yield from self._return.step(t_ns, inbox)
            if self._return.ended is not None:
                self._after_return(self._return.reason, self._return.ended)
                self._return = None
            return
        rally_points_ned_m = () if record is None or record.ended else record.mission.rally_points_ned_m
        yield from self._watch.step(t_ns, inbox, rally_points_ned_m)
        if not self._watch.reason or status is None:
            return
        self._returns += 1
        goal = self._watch.goal(rally_points_ned_m)
        self._return = ReturnRun(f"return-{self._boot_id:x}-{self._returns}", self._watch.reason, goal)
        if record is not None and not record.ended:
            yield from self._hold(record.in_state("interrupted", self._watch.reason), status)

    def _after_return(self, reason: str, end: StepEnd) -> None:
        """Name the outcome of the return in the mission that waits."""
        record = self._record
        if end.end != "succeeded":
            self._watch.overrule()
        if record is not None and record.state == "interrupted":
            outcome = "it has landed" if end.end == "succeeded" else f"the return has ended: {end.reason}"
            self._record = record.in_state("interrupted", f"{reason}; {outcome}")

    def _advance(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Go on with the present step, and begin the next one when it has ended."""
        record, run = self._record, self._run
        if record is None:
            return
        if run is not None:
            yield from run.step(t_ns, inbox, paused=record.state != "running")
            if isinstance(run, StepGoal) and (reply := run.pause_reply(inbox)) is not None:
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
        if reason := somebody_else(status, record.mission_id):
            self._record = record.in_state("interrupted", reason)
            return
        landed, self._takes_off = status.landed and not status.armed, False
        if record.altitude_m is not None and landed and landing_step(step):
            self._record = replace(record, altitude_m=None).next_step()
            return
        if not landed:
            record = replace(record, step_altitude_m=self._with_altitude(record, status).altitude_m)
        is_takeoff = isinstance(step, GoalStep) and step.action == TAKEOFF.name
        takeoff_id = f"{record.goal_id}.takeoff"
        if status.goal_id == takeoff_id:  # it flies on since the run of this service before
            self._takes_off, self._record = True, record
            self._run = StepGoal(TAKEOFF, takeoff_id)
        elif record.altitude_m is not None and landed and not is_takeoff:
            self._takes_off, self._record = True, record
            self._run = StepGoal(TAKEOFF, goal_of(TAKEOFF, {"altitude_m": record.altitude_m}, takeoff_id, t_ns))
        elif isinstance(step, WaitStep):
            self._record = replace(record, altitude_m=None)
            self._run = Wait(t_ns, step.duration_s if record.rest is None else float(record.rest["duration_s"]))
        else:
            self._record = replace(record, altitude_m=None)
            action, fields = self._actions[step.action], step.goal if record.rest is None else record.rest
            self._run = StepGoal(action, goal_of(action, fields, record.goal_id, t_ns))
        if isinstance(self._run, StepGoal) and status.paused and status.goal_id == self._run.goal_id:
            yield from self._run.resume()  # it flies on since the run of this service before, which had paused it
        yield from self._run.step(t_ns, inbox, paused=False)

    def _after(self, record: MissionRecord, end: StepEnd, status: Status | None) -> MissionRecord:
        """The mission after the end of a try."""
        wanted, self._wanted = self._wanted, ""
        if wanted == "stop":
            return record.in_state("stopped", "stopped by a command")
        holds = wanted in ("hold", "skip and hold")
        if wanted in ("skip", "skip and hold"):
            following = record.without_step()
        elif self._takes_off and end.end == "succeeded":
            # A mission that is held may need another takeoff, whose goal must have another id.
            following = record.next_attempt(None) if holds else replace(record, altitude_m=None)
        else:
            following = record.next_step() if end.end == "succeeded" else record.next_attempt(end.rest)
        if wanted == "skip" or (holds and following.ended):
            return following
        if holds:
            return following.in_state(record.state, record.reason)
        if end.end == "succeeded":
            return _still_paused(record, following)
        if end.end == "canceled":
            return following.in_state("interrupted", f"{record.step.label}: {end.reason}")
        return self._after_failure(record, end, status)

    def _after_failure(self, record: MissionRecord, end: StepEnd, status: Status | None) -> MissionRecord:
        """The mission after a failed try, by the step's policy."""
        reason = f"step {record.index + 1}, {record.step.label}: {end.reason}"
        if record.last is not None:
            return record.in_state("failed", f"{record.failure}; then {record.last.label}: {end.reason}")
        policy, failures, before = record.policy, record.failures + 1, record
        record = record.in_state("running")
        if failures <= policy.retries:
            again = replace(record.next_attempt(end.rest), failures=failures, reason=f"tried again: {end.reason}")
            return _still_paused(before, again)
        if policy.then == "skip":
            return _still_paused(before, record.without_step(f"left out {reason}"))
        if policy.then == "stop" or status is None or status.odometry is None or status.landed:
            return record.in_state("failed", end.reason)
        return replace(
            record,
            last=last_goal(policy.then, status, record.mission.rally_points_ned_m),
            failed_attempt=record.attempt,
            attempt=1,
            rest=None,
            reason=reason,
            failure=reason,
        )

    # -- requests --

    def _begin(self, request: Request, status: Status | None) -> Reply:
        mission: Mission = request.payload
        present = self._record
        if self._return is not None:
            return Reply(request.request_id, MissionReply(accepted=False, reason=self._returning(self._return)))
        if present is not None and not present.ended:
            reason = f"the mission {present.mission.name!r} is {present.state}: end it first (jezero mission stop)"
            return Reply(request.request_id, MissionReply(accepted=False, reason=reason))
        if refusal := self._goals_refusal(mission):
            return Reply(request.request_id, MissionReply(accepted=False, reason=refusal))
        self._missions += 1
        mission_id = f"mission-{self._boot_id:x}-{self._missions}"
        self._record = MissionRecord(mission=mission, mission_id=mission_id)
        self._interventions = _interventions_of(status)
        return Reply(request.request_id, MissionReply(accepted=True, mission_id=mission_id))

    def _goals_refusal(self, mission: Mission) -> str:
        """The first mistake in a mission's goals, or ""."""
        for number, step in enumerate(mission.steps, start=1):
            if not isinstance(step, GoalStep):
                continue
            action = self._actions.get(step.action)
            if action is None:
                return f"step {number}: {unknown('action', step.action, self._actions)}"
            if action.mission_refusal:
                return f"step {number}, {step.label}: {action.mission_refusal}"
            try:
                goal_of(action, step.goal, "check", 0)
            except msgspec.ValidationError as error:
                return f"step {number}, {step.label}: {action.name}: {mistake(error, action.goal_type)}"
        return ""

    def _command(self, request: Request, inbox: Inbox) -> Iterator[Output]:
        command: MissionCommand = request.payload
        record = self._record
        refusal = NO_MISSION
        if self._return is not None and command.command != "stop":
            refusal = self._returning(self._return)
        elif record is not None and record.state == "failed" and command.command in ("resume", "skip"):
            self._interventions, refusal = _interventions_of(inbox.latest(STATUS)), ""
            self._record = again = record.again()
            if command.command == "skip":
                self._record = again.without_step()
        elif record is not None and not record.ended:
            if command.command == "pause" and record.state == "running" and isinstance(self._run, StepGoal):
                self._pauses.append(request.request_id)
                yield from self._run.pause()
                return
            refusal = yield from self._carry_out(command.command, record, inbox.latest(STATUS))
        mission_id = "" if record is None else record.mission_id
        yield Reply(request.request_id, MissionReply(accepted=not refusal, reason=refusal, mission_id=mission_id))

    @staticmethod
    def _returning(run: ReturnRun) -> str:
        return f"{run.reason}: wait until it has landed, or end the return with jezero hover"

    def _reply_to_pauses(self, refusal: str, record: MissionRecord) -> Iterator[Output]:
        """Reply to the requests for a pause.

        Args:
            refusal: reason why the goal isn't paused, or "".
        """
        if self._pauses and not refusal and record.state != "running":
            refusal = f"the mission is {record.state}: {record.reason}"[:TEXT_MAX]  # by what came before the reply
        if self._pauses and not refusal:
            self._record = record.in_state("paused", PAUSED)
        for request_id in self._pauses:
            reply = MissionReply(accepted=not refusal, reason=refusal, mission_id=record.mission_id)
            yield Reply(request_id, reply)
        self._pauses.clear()

    def _carry_out(self, command: str, record: MissionRecord, status: Status | None) -> Generator[Output, None, str]:
        """Carry out a command; returns the reason of a refusal, or ""."""
        run = self._run
        waits = record.state in ("paused", "interrupted")
        if command == "skip" and self._wanted == "stop":
            return ENDING
        if command in ("resume", "swapped") and not waits:
            return "the mission is running"
        if command == "swapped" and (refusal := swap_refusal(record, status)):
            return refusal
        if command == "pause" and waits:
            return f"the mission is {record.state} already"
        if command in ("resume", "swapped"):
            if self._wanted:
                return ENDING
            self._interventions = _interventions_of(status)
            self._record = record.in_state("running")
            if status is not None and status.landed and record.altitude_m is None:  # the stack was restarted
                self._record = self._record.from_ground(armed=status.armed)
            if isinstance(run, StepGoal):
                yield from run.resume()
        elif command == "pause":
            self._record = record.in_state("paused", PAUSED)
        else:
            self._interventions = _interventions_of(status)
            self._wanted = "skip" if command == "skip" else "stop"
            run = self._run = run or self._goal_of_run_before(record, status)
            if run is not None:
                yield from run.cancel()
            else:
                self._record = self._after(record, StepEnd("canceled"), None)
        return ""

    def _goal_of_run_before(self, record: MissionRecord, status: Status | None) -> StepGoal | None:
        """The mission's goal that flies on since the run of this service before, or may do so; None for none."""
        if status is None:
            step = record.step
            return StepGoal(self._actions[step.action], record.goal_id) if isinstance(step, GoalStep) else None
        if not flies_goal_of(status, record.mission_id):
            return None
        return StepGoal(self._actions[status.action], status.goal_id)

    # -- outputs --

    def _publish(self, t_ns: int, *, changed: bool) -> Iterator[Output]:
        last_ns = self._published_ns
        due = last_ns is None or not 0 <= t_ns - last_ns < PUBLISH_PERIOD_NS  # a restarted vehicle's time begins anew
        if not (due or changed):
            return
        self._published_ns = t_ns
        record, goal_id = self._record, "" if self._run is None else self._run.goal_id
        yield Publish(
            MISSION, MissionProgress(t_ns=t_ns, state="idle") if record is None else record.message(t_ns, goal_id)
        )
        health = Health("ok", self._health_text())
        if health != self._health:
            self._health = health
            yield health

    def _health_text(self) -> str:
        record = self._record
        mission = "no mission" if record is None else f"{record.mission.name}: {record.state}"
        way_home = self._watch.text if self._return is None else self._return.reason
        return f"{mission}; {way_home}" if way_home else mission


def _interventions_of(status: Status | None) -> tuple[int, int] | None:
    """The bridge's boot id, and its number of interventions; None for an unknown status.

    The bridge publishes an intervention before it replies to it. So a person who intervenes and then sends a command
    to the mission means both, and whoever intervenes after the command means to stop the mission.
    """
    return None if status is None else (status.bridge_boot_id, status.interventions)


def _still_paused(before: MissionRecord, following: MissionRecord) -> MissionRecord:
    """The mission after the end of a goal: one that was paused by a command waits for another one."""
    if before.state != "paused" or following.ended:
        return following
    return following.in_state("paused", PAUSED)
