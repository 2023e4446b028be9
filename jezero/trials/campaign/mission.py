"""One seed's mission: the whole stack in virtual time, two clients, some faults, and everything judged."""

import hashlib
import zlib
from collections import Counter
from collections.abc import Callable
from functools import partial
from random import Random

import msgspec

from jezero.report.flight_log import line
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.state import Status, StatusCode
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.service import Simulator
from jezero.trials.campaign.clients import PERIOD_S, Client, Sent
from jezero.trials.campaign.faults import AUTOPILOT, BRIDGE, CLIENTS, COUNTS, SENSOR_KINDS, Fault, Kind, draw_faults
from jezero.trials.campaign.judge import Judge, Violation
from jezero.trials.campaign.judge_bridge import WatchedBridge
from jezero.trials.campaign.judge_landing import WatchedLanding
from jezero.trials.campaign.judge_others import GoalRecord, TruthWatch, WatchedAutopilot, WatchedServer
from jezero.trials.campaign.link_faults import Disturber
from jezero.trials.campaign.worlds import PHYSICS, WORLDS, Sensing, World

READY_WITHIN_S = 20.0
FAULTS_WITHIN_S = 42.0
WISHES_FOR_S = 47.0
QUIET_S = 10.0
SETTLED_WITHIN_S = 200.0
"""A landing on the rover may take 180 s."""
STEADY_S = 3.0
STEADY_MPS = 0.8
AFTERMATH_S = 5.0


class MissionReport(msgspec.Struct, frozen=True, kw_only=True):
    """How one seed went.

    Attributes:
        violations: in words, in the order of time.
        faults: how many of each kind.
        states: how often each status was reached.
        goals: outcomes of all goals that were accepted, and how many were rejected or lost with their server.
        log_sha256: of all messages; equal for two flights of the same seed.
    """

    seed: int
    violations: list[str]
    faults: dict[str, int]
    states: dict[str, int]
    goals: dict[str, int]
    sim_time_s: float
    log_sha256: str


def named_random(seed: int, name: str) -> Random:
    """A generator of its own for each purpose."""
    return Random(zlib.crc32(f"campaign/{seed}/{name}".encode()))


class Mission:
    """A stack with its observers, clients and faults.

    Args:
        tell: called with a line for every event, for people.
        world: what it flies in.
        counts: how many faults it may have.
    """

    def __init__(
        self,
        seed: int,
        tell: Callable[[str], None] = lambda text: None,
        world: World = PHYSICS,
        counts: range = COUNTS,
    ) -> None:
        self.seed = seed
        self.judge = Judge()
        self.bus = world.make_bus(seed)
        self._world = world
        self._makers = world.make_makers(seed)
        self._runs: Counter[str] = Counter()
        self._goals: list[GoalRecord] = []
        self._flights: dict[str, set[str]] = {}
        self._lost: set[tuple[str, int]] = set()
        """Runs of services that were killed."""
        self._sensing: Sensing | None = None
        self._simulators: list[Simulator] = []
        self._disturber = Disturber(self.bus, named_random(seed, "links"))
        self._sensor_rng = named_random(seed, "sensors")
        self._tell = tell
        self._digest = hashlib.sha256()
        self._status: Status | None = None
        self._status_decoder = msgspec.json.Decoder(Status)
        self._truth = TruthWatch(self.judge)
        known = (world.sensing, world.autopilot, BRIDGE, *topics.ACTIONS)
        others = tuple(name for name in self._makers if name not in known)
        faults = draw_faults(named_random(seed, "faults"), FAULTS_WITHIN_S, others, counts)
        self.faults = [world.translate(fault) for fault in faults]
        self.clients = [Client(name, self.bus, named_random(seed, name), self._say) for name in CLIENTS]
        self.bus.observe(self._observe)
        self.bus.observe(self._truth)
        for name in self._makers:
            self._start(name)

    def fly(self) -> MissionReport:
        """The whole mission."""
        self.bus.run_for(READY_WITHIN_S, stop=lambda: self._status is not None and self._status.ready)
        begun_ns = self.bus.t_ns
        for fault in self.faults:
            self.bus.at(begun_ns + int(fault.start_s * NS_PER_S), "", partial(self._begin, fault))
        last_s = max(fault.start_s + fault.duration_s for fault in self.faults)
        self._run(WISHES_FOR_S, wishes=True)
        self._run(max(0.0, last_s - WISHES_FOR_S) + QUIET_S, wishes=False)
        if not self._is_over:
            self._settle()
        if not self._is_over:
            self._judge_goals()
        for simulator in self._simulators:
            simulator.close()
        return self._report()

    # -- the stack -----------------------------------------------------------------------------------------

    def _start(self, name: str) -> None:
        self._runs[name] += 1
        run = self._runs[name]
        service = self._makers[name](zlib.crc32(f"{self.seed}/{name}/{run}".encode()))
        self.bus.add(self._watched(name, run, service))

    def _watched(self, name: str, run: int, service: Service) -> Service:
        if isinstance(service, Simulator):
            self._simulators.append(service)
        if name == self._world.sensing:
            service = self._sensing = self._world.with_faults(service, self._sensor_rng)
        if name == self._world.autopilot:
            return WatchedAutopilot(service, self.judge, lambda: self._disturber.late_ns)
        if name == self._world.sensing:
            return service
        if name == BRIDGE:
            return WatchedBridge(service, self.judge, self._flights)
        if name == topics.LAND_ON_SPOT.name:
            service = WatchedLanding(service, self.judge, lambda: self._truth.truth)
        return WatchedServer(service, run, self.judge, self._goals) if name in topics.ACTIONS else service

    def _begin(self, fault: Fault) -> None:
        self._say(f"fault: {fault}")
        if fault.kind in SENSOR_KINDS:
            assert self._sensing is not None
            sensing = self._sensing
            running = sensing.begin(fault)
            end_ns = self.bus.t_ns + int(fault.duration_s * NS_PER_S)
            self.bus.at(end_ns, "", lambda: sensing.active.remove(running))
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
            self._disturber.begin(fault)

    def _restart(self, name: str) -> None:
        self._say(f"{name} is back")
        self._start(name)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        self._digest.update(line(t_ns, topic, data))
        if topic == topics.STATUS.name:
            status = self._status_decoder.decode(data)
            before, self._status = self._status, status
            if before is None or (before.code, before.bridge_boot_id) != (status.code, status.bridge_boot_id):
                self._say(f"status {status.code} {status.name}: {status.text}")

    def _say(self, text: str) -> None:
        self._tell(f"{self.bus.t_ns / NS_PER_S:8.3f} s  {text}")

    # -- time ----------------------------------------------------------------------------------------------

    def _run(self, seconds: float, *, wishes: bool) -> None:
        end_ns = self.bus.t_ns + int(seconds * NS_PER_S)
        while self.bus.t_ns < end_ns and not self._is_over:
            for client in self.clients:
                client.step(self._status, wishes=wishes)
            self.bus.run_for(PERIOD_S)

    @property
    def _is_over(self) -> bool:
        """Soon after something broke: what follows is mostly its consequence."""
        found = self.judge.violations
        return bool(found) and self.bus.t_ns > (found[0].t_s + AFTERMATH_S) * NS_PER_S

    def _settle(self) -> None:
        """Nobody wishes for anything any more, all faults are over: the vehicle ends hovering or landed."""
        steady_s = waited_s = 0.0
        while steady_s < STEADY_S and waited_s < SETTLED_WITHIN_S and not self._is_over:
            self._run(PERIOD_S, wishes=False)
            waited_s += PERIOD_S
            steady_s = steady_s + PERIOD_S if self._is_steady() else 0.0
        status = self._status
        text = "no status" if status is None else f"{status.name} in {status.autopilot_mode}: {status.text}"
        text = f"after {waited_s:.0f} s of quiet {self._truth.speed_mps:.2f} m/s fast, status {text}"
        settled = steady_s >= STEADY_S or waited_s < SETTLED_WITHIN_S
        self.judge.check(settled, self.bus.t_ns, "ends hovering or landed", text)

    def _is_steady(self) -> bool:
        status, truth = self._status, self._truth.truth
        if status is None or truth is None or self._truth.speed_mps > STEADY_MPS:
            return False
        landed = status.code == StatusCode.IDLE and not status.armed and not truth.armed_motors
        return landed or (status.code == StatusCode.HOVER and not status.control_id)

    # -- goals ---------------------------------------------------------------------------------------------

    def _judge_goals(self) -> None:
        """Every accepted goal has ended, and its client knows how."""
        known = {sent.goal.goal_id: sent for client in self.clients for sent in client.sent}
        for record in self._goals:
            sent, t_ns = known.get(record.goal_id), self.bus.t_ns
            if (record.action, record.run) in self._lost and not record.outcomes:
                continue
            text = f"{record.action} {record.goal_id}, accepted at {record.accepted_ns / NS_PER_S:.1f} s, has no end"
            self.judge.check(bool(record.outcomes), t_ns, "every goal ends exactly once", text)
            if sent is not None and record.outcomes and (record.action, record.run) not in self._lost:
                self._judge_learned(record, sent)

    def _judge_learned(self, record: GoalRecord, sent: Sent) -> None:
        outcomes = [outcome for _, outcome in record.outcomes]
        text = f"{record.action} {record.goal_id} {outcomes[0]}, its client believes {sent.learned or 'nothing'}"
        good = sent.learned in outcomes
        self.judge.check(good, self.bus.t_ns, "whoever asks learns how a goal ended", text)

    def _report(self) -> MissionReport:
        goals: Counter[str] = Counter()
        for record in self._goals:
            goals[record.outcomes[0][1] if record.outcomes else "lost with its server"] += 1
        goals["rejected"] = sum(sent.learned == "rejected" for client in self.clients for sent in client.sent)
        violations: list[Violation] = sorted(self.judge.violations, key=lambda violation: violation.t_s)
        return MissionReport(
            seed=self.seed,
            violations=[str(violation) for violation in violations],
            faults=dict(Counter(str(fault.kind) for fault in self.faults)),
            states=dict(self.judge.states),
            goals=dict(goals),
            sim_time_s=round(self.bus.t_ns / NS_PER_S, 3),
            log_sha256=self._digest.hexdigest(),
        )


def fly_mission(
    seed: int, tell: Callable[[str], None] = lambda text: None, world: str = "physics", counts: range = COUNTS
) -> MissionReport:
    """Fly one seed's mission.

    Args:
        world: one of WORLDS.
        counts: how many faults it may have.
    """
    return Mission(seed, tell, WORLDS[world], counts).fly()
