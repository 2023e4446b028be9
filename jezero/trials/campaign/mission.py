"""The mission of one seed: the whole stack in virtual time with two clients and some faults, all of it judged."""

import zlib
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

import msgspec

from jezero.base.config import load_config
from jezero.base.plugins import action_names
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.writer import RECORDING
from jezero.runtime.memory_bus import Observer
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.goals import Goal
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.service import Simulator
from jezero.trials.campaign.clients import PERIOD_S, Client, Pauser, SentGoal
from jezero.trials.campaign.faults import (
    AUTOPILOT,
    BRIDGE,
    CLIENTS,
    FAULT_COUNTS,
    SENSOR_KINDS,
    Fault,
    Kind,
    LinkFaults,
    draw_faults,
)
from jezero.trials.campaign.fence import FenceJudge, FenceSetter, UnawareServer, is_fence_refusal
from jezero.trials.campaign.judge import Judge, TruthJudge, Violation
from jezero.trials.campaign.judge_actions import GoalRecord, LandOnSpotJudge, PauseJudge, ServerJudge
from jezero.trials.campaign.judge_control import AutopilotJudge, BridgeJudge
from jezero.trials.campaign.missions import ENDS, MISSION_PROBABILITY, MissionClient, MissionJudge, MissionLog
from jezero.trials.campaign.models import MODELS, PHYSICS, CampaignModel, FaultySensors
from jezero.trials.recording import MessageDigest, virtual_recording
from jezero.trials.stack import mission_maker

MISSION = "mission"
READY_TIMEOUT_S = 20.0
FAULTS_START_MAX_S = 42.0
GOALS_DURATION_S = 47.0
QUIET_DURATION_S = 10.0
SETTLE_TIMEOUT_S = 200.0
"""A landing on the rover may take 180 s."""
STEADY_DURATION_S = 3.0
STEADY_SPEED_MAX_MPS = 0.8
AFTER_VIOLATION_S = 5.0


class MissionReport(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of the mission of one seed.

    Attributes:
        seed: the mission's seed.
        violations: sentences, in the order of time.
        faults: number of faults of each kind.
        states: number of times that each status was reached.
        goals: number of accepted goals by outcome, and of those that were rejected or lost with their server; number of
            pauses, resumptions and changes that servers accepted, of fences that were set and of goals refused by them.
        sim_time_s: length of the mission in virtual time.
        messages_sha256: SHA-256 of all messages; equal for two missions of the same seed.
        recording: file with the recording of a mission with violations; "" if there is none.
    """

    seed: int
    violations: list[str]
    faults: dict[str, int]
    states: dict[str, int]
    goals: dict[str, int]
    sim_time_s: float
    messages_sha256: str
    recording: str = ""


def named_random(seed: int, name: str) -> Random:
    """Random generator for one purpose, so that purposes do not change each other's numbers."""
    return Random(zlib.crc32(f"campaign/{seed}/{name}".encode()))


class CampaignMission:
    """A stack with its judges, clients and faults.

    Args:
        seed: seed of everything random.
        on_event: called with a line of text for each event.
        model: of the vehicle.
        fault_counts: allowed numbers of faults.
        record: gets all messages and the services' journals; None for a mission that is not recorded.
    """

    def __init__(
        self,
        seed: int,
        on_event: Callable[[str], None] = lambda text: None,
        model: CampaignModel = PHYSICS,
        fault_counts: range = FAULT_COUNTS,
        record: Observer | None = None,
    ) -> None:
        self.seed = seed
        self.judge = Judge()
        self.bus = model.make_bus(seed)
        self._model = model
        self._makers = model.make_service_makers(seed)
        self.missions = self._mission_client()
        vehicle = load_config(VehicleConfig, "vehicle")
        self._limits = vehicle.limits
        if self.missions is not None:
            self._makers.setdefault(MISSION, mission_maker(vehicle))
        self._mission_logs: dict[str, MissionLog] = {}
        self._mission_goals: dict[str, Goal] = {}
        self._runs: Counter[str] = Counter()
        self._goals: list[GoalRecord] = []
        self._flights: dict[str, set[str]] = {}
        self._lost: set[tuple[str, int]] = set()
        """(service, run) of the services that were killed."""
        self._sensors: FaultySensors | None = None
        self._simulators: list[Simulator] = []
        self._link_faults = LinkFaults(self.bus, named_random(seed, "links"))
        self._sensor_rng = named_random(seed, "sensors")
        self._on_event = on_event
        self._digest = MessageDigest()
        self._status: Status | None = None
        self._status_decoder = msgspec.json.Decoder(Status)
        self._truth = TruthJudge(self.judge)
        self.fence_judge = FenceJudge(self.judge)
        fence_rng = named_random(seed, "fence")
        self._fences = FenceSetter(self.bus, fence_rng, FAULTS_START_MAX_S, self._report_event)
        known = (model.sensors, model.autopilot, BRIDGE, *action_names())
        others = tuple(name for name in self._makers if name not in known)
        faults = draw_faults(named_random(seed, "faults"), FAULTS_START_MAX_S, others, fault_counts)
        self.faults = [model.translate_fault(fault) for fault in faults]
        self.clients = [self._client(name) for name in CLIENTS] if self.missions is None else []
        self.bus.observe(self._observe)
        self.bus.observe(self._truth)
        self.bus.observe(self.fence_judge)
        if record is not None:
            self.bus.observe(record)
            self.bus.read_journals(record)
        for name in self._makers:
            self._start(name)

    def fly(self) -> MissionReport:
        """Fly the whole mission."""
        self.bus.run_for(READY_TIMEOUT_S, stop=lambda: self._status is not None and self._status.ready)
        start_ns = self.bus.t_ns
        for fault in self.faults:
            self.bus.at(start_ns + int(fault.start_s * NS_PER_S), "", partial(self._start_fault, fault))
        self._fences.start()
        last_s = max(fault.start_s + fault.duration_s for fault in self.faults)
        self._run(GOALS_DURATION_S, active=True)
        self._run(max(0.0, last_s - GOALS_DURATION_S) + QUIET_DURATION_S, active=False)
        if not self._is_over:
            self._settle()
        if not self._is_over:
            self._judge_goals()
        self.bus.end_journals()
        for simulator in self._simulators:
            simulator.close()
        return self._report()

    def _client(self, name: str) -> Client:
        pauser = Pauser(name, self.bus, named_random(self.seed, f"{name}/pauses"), self._report_event)
        return Client(name, self.bus, named_random(self.seed, name), self._report_event, pauser)

    def _mission_client(self) -> MissionClient | None:
        """The client that sends missions; None in seeds in which clients send single goals."""
        rng = named_random(self.seed, MISSION)
        if rng.random() >= MISSION_PROBABILITY:
            return None
        return MissionClient(self.bus, rng, self._report_event)

    # -- the stack -----------------------------------------------------------------------------------------

    def _start(self, name: str) -> None:
        self._runs[name] += 1
        run = self._runs[name]
        service = self._makers[name](zlib.crc32(f"{self.seed}/{name}/{run}".encode()))
        self.bus.add(self._judged(name, run, service))

    def _judged(self, name: str, run: int, service: Service) -> Service:
        if isinstance(service, Simulator):
            self._simulators.append(service)
        if name == self._model.sensors:
            service = self._sensors = self._model.add_sensor_faults(service, self._sensor_rng)
        if name == self._model.autopilot:
            return AutopilotJudge(service, self.judge, lambda: self._link_faults.delay_max_ns, self.fence_judge.on_gap)
        if name == self._model.sensors:
            return service
        if name == BRIDGE:
            return BridgeJudge(service, self.judge, self._flights, self._limits)
        if name == topics.LAND_ON_SPOT.name:
            service = LandOnSpotJudge(service, self.judge, lambda: self._truth.truth)
        if name == MISSION:
            return MissionJudge(service, self.judge, self._mission_logs, self._mission_goals)
        if name not in action_names():
            return service
        if name in self._fences.unaware:
            service = UnawareServer(service)
        return ServerJudge(PauseJudge(service, self.judge), run, self.judge, self._goals)

    def _start_fault(self, fault: Fault) -> None:
        self._report_event(f"fault: {fault}")
        if fault.kind in SENSOR_KINDS:
            assert self._sensors is not None
            sensors = self._sensors
            running = sensors.start(fault)
            end_ns = self.bus.t_ns + int(fault.duration_s * NS_PER_S)
            self.bus.at(end_ns, "", lambda: sensors.active.remove(running))
        elif fault.kind is Kind.FREEZE and self.bus.runs(fault.where):
            self.bus.freeze(fault.where, fault.duration_s)
        elif fault.kind is Kind.KILL and self.bus.has(fault.where):
            self._lost.add((fault.where, self._runs[fault.where]))
            if fault.where == AUTOPILOT and self._truth.truth is not None:
                self._truth.falls_in_epoch = self._truth.truth.epoch_id
            self.bus.remove(fault.where)
            restart_ns = self.bus.t_ns + int(fault.duration_s * NS_PER_S)
            self.bus.at(restart_ns, "", lambda: self._restart(fault.where))
        elif fault.kind not in (Kind.FREEZE, Kind.KILL):
            self._link_faults.start(fault)

    def _restart(self, name: str) -> None:
        self._report_event(f"{name} is back")
        self._start(name)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        self._digest.update(t_ns, topic, data)
        if topic == topics.STATUS.name:
            status = self._status_decoder.decode(data)
            previous, self._status = self._status, status
            if previous is None or (previous.code, previous.bridge_boot_id) != (status.code, status.bridge_boot_id):
                self._report_event(f"status {status.code} {status.name}: {status.text}")

    def _report_event(self, text: str) -> None:
        self._on_event(f"{self.bus.t_ns / NS_PER_S:8.3f} s  {text}")

    # -- time ----------------------------------------------------------------------------------------------

    def _run(self, seconds: float, *, active: bool) -> None:
        end_ns = self.bus.t_ns + int(seconds * NS_PER_S)
        while self.bus.t_ns < end_ns and not self._is_over:
            for client in self.clients:
                client.step(self._status, active=active)
            if self.missions is not None:
                self.missions.step(self._status, active=active)
            self.bus.run_for(PERIOD_S)

    @property
    def _is_over(self) -> bool:
        """Whether a violation is some seconds old: later violations are mostly its consequences."""
        violations = self.judge.violations
        return bool(violations) and self.bus.t_ns > (violations[0].t_s + AFTER_VIOLATION_S) * NS_PER_S

    def _settle(self) -> None:
        """Check that the vehicle ends hovering or landed after the last goal and the last fault."""
        steady_s = waited_s = 0.0
        while steady_s < STEADY_DURATION_S and waited_s < SETTLE_TIMEOUT_S and not self._is_over:
            self._run(PERIOD_S, active=False)
            waited_s += PERIOD_S
            steady_s = steady_s + PERIOD_S if self._is_steady() else 0.0
        status = self._status
        text = "no status" if status is None else f"{status.name} in {status.autopilot_mode}: {status.text}"
        text = f"after {waited_s:.0f} s of quiet: speed {self._truth.speed_mps:.2f} m/s, status {text}"
        settled = steady_s >= STEADY_DURATION_S or waited_s < SETTLE_TIMEOUT_S
        self.judge.check(settled, self.bus.t_ns, "ends hovering or landed", text)

    def _is_steady(self) -> bool:
        status, truth = self._status, self._truth.truth
        if status is None or truth is None or self._truth.speed_mps > STEADY_SPEED_MAX_MPS:
            return False
        landed = status.code == StatusCode.IDLE and not status.armed and not truth.armed_motors
        return landed or (status.code == StatusCode.HOVER and not status.grant)

    # -- goals ---------------------------------------------------------------------------------------------

    def _judge_goals(self) -> None:
        """Check that every accepted goal has ended, and that its client knows how."""
        known = self._sent
        aware = [record for record in self._goals if record.action not in self._fences.unaware]
        self.fence_judge.judge_goals(
            aware, {goal_id: sent.goal for goal_id, sent in known.items()} | self._mission_goals
        )
        self.fence_judge.judge_refusals(known)
        for mission_id, log in self._mission_logs.items():
            text = f"{mission_id} is {log.state} after all stops"
            self.judge.check(log.state in ENDS, self.bus.t_ns, "a mission ends as its file says", text)
        for record in self._goals:
            sent, t_ns = known.get(record.goal_id), self.bus.t_ns
            if (record.action, record.run) in self._lost and not record.outcomes:
                continue
            text = f"{record.action} {record.goal_id}, accepted at {record.accepted_ns / NS_PER_S:.1f} s, has no end"
            self.judge.check(bool(record.outcomes), t_ns, "every goal ends exactly once", text)
            if sent is not None and record.outcomes and (record.action, record.run) not in self._lost:
                self._judge_known_outcome(record, sent)

    @property
    def _sent(self) -> dict[str, SentGoal]:
        """All goals that clients sent, by their ids."""
        return {sent.goal.goal_id: sent for client in self.clients for sent in client.sent}

    def _judge_known_outcome(self, record: GoalRecord, sent: SentGoal) -> None:
        outcomes = [outcome for _, outcome in record.outcomes]
        text = f"{record.action} {record.goal_id} {outcomes[0]}, its client knows {sent.known_outcome or 'nothing'}"
        is_known = sent.known_outcome in outcomes
        self.judge.check(is_known, self.bus.t_ns, "every client learns how its goal ended", text)

    def _report(self) -> MissionReport:
        goals: Counter[str] = Counter()
        for record in self._goals:
            goals[record.outcomes[0][1] if record.outcomes else "lost with its server"] += 1
        goals["rejected"] = sum(sent.known_outcome == "rejected" for sent in self._sent.values())
        replies = [reply for sent in self._sent.values() for query in sent.queries for reply in query.replies]
        goals["refused by the fence"] = sum(is_fence_refusal(reply) for reply in replies)
        goals["fences"] = self._fences.accepted
        if self.missions is not None:
            goals.update(self.missions.accepted)
        for client in self.clients:
            goals.update(client.pauser.accepted)
        violations: list[Violation] = sorted(self.judge.violations, key=lambda violation: violation.t_s)
        return MissionReport(
            seed=self.seed,
            violations=[str(violation) for violation in violations],
            faults=dict(Counter(str(fault.kind) for fault in self.faults)),
            states=dict(self.judge.states),
            goals=dict(goals),
            sim_time_s=round(self.bus.t_ns / NS_PER_S, 3),
            messages_sha256=self._digest.hexdigest(),
        )


def fly_mission(
    seed: int,
    on_event: Callable[[str], None] = lambda text: None,
    model: str = "physics",
    fault_counts: range = FAULT_COUNTS,
    recordings: Path | None = None,
) -> MissionReport:
    """Fly the mission of one seed; one with violations is flown once more, the same, with a recording.

    Args:
        on_event: called with a line of text for each event.
        model: name of one of MODELS.
        fault_counts: allowed numbers of faults.
        recordings: folder that gets the recording of a mission with violations, as <model>-<seed>/flight.mcap.

    Raises:
        OSError: the recording can't be written.
    """
    report = CampaignMission(seed, on_event, MODELS[model], fault_counts).fly()
    if not report.violations or recordings is None:
        return report
    path = recordings / f"{model}-{seed}" / RECORDING
    faults = f"{fault_counts.start}..{fault_counts.stop - 1}"
    with virtual_recording(path, seed, model=model, faults=faults) as writer:
        CampaignMission(seed, model=MODELS[model], fault_counts=fault_counts, record=writer.write).fly()
    return msgspec.structs.replace(report, recording=str(path))
