"""Missions of many seeds on several processes, and the sums of their reports."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from multiprocessing.pool import AsyncResult

import msgspec

from jezero.schemas.state import StatusCode
from jezero.trials.campaign.faults import Kind
from jezero.trials.campaign.mission import MissionReport, fly_mission
from jezero.trials.workers import workers


class CampaignReport(msgspec.Struct, kw_only=True):
    """Sums of the reports of all missions added so far.

    Attributes:
        seeds: number of missions.
        failed: violations of each seed that had any.
        faults: number of faults of each kind, kinds that never occurred included.
        states: number of times that each status was reached.
        goals: number of accepted goals by outcome, and of rejected ones.
        sim_time_s: virtual time of all missions together.
    """

    seeds: int = 0
    failed: dict[int, list[str]] = msgspec.field(default_factory=dict)
    faults: dict[str, int] = msgspec.field(default_factory=lambda: {str(kind): 0 for kind in Kind})
    states: dict[str, int] = msgspec.field(default_factory=lambda: {code.name: 0 for code in StatusCode})
    goals: dict[str, int] = msgspec.field(default_factory=dict)
    sim_time_s: float = 0.0

    def add(self, report: MissionReport) -> None:
        """Add one mission."""
        self.seeds += 1
        self.sim_time_s = round(self.sim_time_s + report.sim_time_s, 3)
        for counts, added in ((self.faults, report.faults), (self.states, report.states), (self.goals, report.goals)):
            for name, count in added.items():
                counts[name] = counts.get(name, 0) + count
        if report.violations:
            self.failed[report.seed] = report.violations


def fly_campaign(
    seeds: Iterable[int], jobs: int, mission: Callable[[int], MissionReport] = fly_mission
) -> Generator[MissionReport, None, None]:
    """Fly all seeds and yield their reports in the same order.

    Args:
        seeds: read one by one, a few ahead of the reports.
        jobs: number of processes that fly in parallel.
        mission: flies one seed.
    """
    if jobs == 1:
        yield from map(mission, seeds)
        return
    with workers(jobs) as pool:
        pending: deque[AsyncResult[MissionReport]] = deque()
        for seed in seeds:
            pending.append(pool.apply_async(mission, (seed,)))
            if len(pending) >= 2 * jobs:
                yield pending.popleft().get()
        yield from (flown.get() for flown in pending)
