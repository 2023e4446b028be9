"""Many seeds' missions, on several processes, and what they come to."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from multiprocessing.pool import AsyncResult

import msgspec

from jezero.schemas.state import StatusCode
from jezero.trials.campaign.faults import Kind
from jezero.trials.campaign.mission import MissionReport, fly_mission
from jezero.trials.workers import workers


class CampaignReport(msgspec.Struct, kw_only=True):
    """What the missions that were added have come to.

    Attributes:
        failed: violations by seed, of those that had any.
        faults: how many of each kind there were, those that never occurred included.
        states: how often each status was reached.
        goals: how the accepted ones ended, and how many were rejected.
    """

    seeds: int = 0
    failed: dict[int, list[str]] = msgspec.field(default_factory=dict)
    faults: dict[str, int] = msgspec.field(default_factory=lambda: {str(kind): 0 for kind in Kind})
    states: dict[str, int] = msgspec.field(default_factory=lambda: {code.name: 0 for code in StatusCode})
    goals: dict[str, int] = msgspec.field(default_factory=dict)
    sim_time_s: float = 0.0

    def add(self, report: MissionReport) -> None:
        """One more mission."""
        self.seeds += 1
        self.sim_time_s = round(self.sim_time_s + report.sim_time_s, 3)
        for counts, more in ((self.faults, report.faults), (self.states, report.states), (self.goals, report.goals)):
            for name, number in more.items():
                counts[name] = counts.get(name, 0) + number
        if report.violations:
            self.failed[report.seed] = report.violations


def fly_campaign(
    seeds: Iterable[int], jobs: int, mission: Callable[[int], MissionReport] = fly_mission
) -> Generator[MissionReport, None, None]:
    """Fly all seeds, and report in their order.

    Args:
        seeds: taken one by one as they are flown, a few ahead of the reports.
        jobs: processes that fly at the same time.
        mission: flies one seed.
    """
    if jobs == 1:
        yield from map(mission, seeds)
        return
    with workers(jobs) as pool:
        waiting: deque[AsyncResult[MissionReport]] = deque()
        for seed in seeds:
            waiting.append(pool.apply_async(mission, (seed,)))
            if len(waiting) >= 2 * jobs:
                yield waiting.popleft().get()
        yield from (flown.get() for flown in waiting)
