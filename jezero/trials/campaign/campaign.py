"""A campaign: its seeds, the missions of all of them on several processes, and the sums of their reports."""

import os
import re
import subprocess
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from multiprocessing.pool import AsyncResult
from pathlib import Path

import msgspec

from jezero.schemas.state import StatusCode
from jezero.trials.campaign.faults import Kind
from jezero.trials.campaign.mission import MissionReport, fly_mission
from jezero.trials.workers import workers

WHOLE_HASH = re.compile(r"[0-9a-f]{40}")
FIRST_MAX = 100_000_000


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


class NoCheckoutError(Exception):
    """Git is not installed, or the folder is in no checkout; the text is the reason."""


def commit_hash(revision: str, folder: Path) -> str:
    """Hash of a commit, also in a shallow clone.

    Args:
        revision: a full hash, which needs no checkout, or any revision of the folder's checkout, e.g. HEAD.
        folder: folder of the checkout.

    Raises:
        NoCheckoutError: there is no git, or the folder is in no checkout.
        ValueError: the checkout has no such commit.
    """
    if WHOLE_HASH.fullmatch(revision):
        return revision
    try:
        inside = _git(folder, "rev-parse", "--git-dir")
    except FileNotFoundError:
        raise NoCheckoutError("git is not installed") from None
    if inside.returncode != 0:
        raise NoCheckoutError(inside.stderr.strip().partition("\n")[0])
    found = _git(folder, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
    if found.returncode != 0:
        raise ValueError(f"{folder} has no commit {revision}")
    return found.stdout.strip()


def _git(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        ("git", *words), cwd=folder, env=os.environ | {"LC_ALL": "C"}, capture_output=True, text=True, check=False
    )


def first_seed(commit: str) -> int:
    """First seed of a commit: other commits fly other seeds, the same commit always the same ones."""
    return int(commit[:12], 16) % FIRST_MAX


def seeds_for_minutes(seeds: Iterable[int], minutes: float) -> Iterator[int]:
    """Yield seeds until the time in minutes is over; at least one."""
    end_s = time.monotonic() + 60.0 * minutes
    for seed in seeds:
        yield seed
        if time.monotonic() >= end_s:
            return
