"""Many seeds' missions, on several processes, and what they come to."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.pool import AsyncResult

import msgspec

from jezero.deploy.campaign.faults import Kind
from jezero.deploy.campaign.mission import MissionReport, fly_mission
from jezero.deploy.workers import workers
from jezero.schemas.state import StatusCode


class CampaignReport(msgspec.Struct, frozen=True, kw_only=True):
    """What a range of seeds came to.

    Attributes:
        failed: violations by seed, of those that had any.
        faults: how many of each kind there were, those that never occurred included.
        states: how often each status was reached.
        goals: how the accepted ones ended, and how many were rejected.
    """

    seeds: int
    failed: dict[int, list[str]]
    faults: dict[str, int]
    states: dict[str, int]
    goals: dict[str, int]
    sim_time_s: float


def fly_campaign(
    seeds: Iterable[int],
    jobs: int,
    tell: Callable[[MissionReport], None] = lambda report: None,
    mission: Callable[[int], MissionReport] = fly_mission,
) -> CampaignReport:
    """Fly all seeds.

    Args:
        seeds: taken one by one as they are flown, a few ahead of the reports.
        jobs: processes that fly at the same time.
        tell: called with each mission's report, in the order of the seeds.
        mission: flies one seed.
    """
    faults = Counter({str(kind): 0 for kind in Kind})
    states = Counter({code.name: 0 for code in StatusCode})
    goals: Counter[str] = Counter()
    failed: dict[int, list[str]] = {}
    count, sim_time_s = 0, 0.0
    for report in _reports(seeds, jobs, mission):
        tell(report)
        count += 1
        sim_time_s += report.sim_time_s
        faults.update(report.faults)
        states.update(report.states)
        goals.update(report.goals)
        if report.violations:
            failed[report.seed] = report.violations
    return CampaignReport(
        seeds=count,
        failed=failed,
        faults=dict(faults),
        states=dict(states),
        goals=dict(goals),
        sim_time_s=round(sim_time_s, 1),
    )


def _reports(seeds: Iterable[int], jobs: int, mission: Callable[[int], MissionReport]) -> Iterator[MissionReport]:
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
