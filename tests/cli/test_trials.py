"""Which seeds `jezero campaign` flies; the missions themselves are flown elsewhere."""

import json
import subprocess
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from jezero.cli.trials import campaign
from jezero.recording import open_recording
from jezero.trials.campaign import campaign as flown
from jezero.trials.campaign.campaign import first_seed, seeds_for_minutes
from jezero.trials.campaign.judge import TruthJudge
from jezero.trials.campaign.mission import MissionReport

HASH = "0123456789abcdef0123456789abcdef01234567"

Run = Callable[..., tuple[Result, list[int]]]


def flown_well(seed: int) -> MissionReport:
    return MissionReport(
        seed=seed,
        violations=[],
        faults={"drop": 2},
        states={"HOVER": 1},
        goals={},
        sim_time_s=1800.0,
        messages_sha256="",
    )


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Runs the command in an empty folder; returns its result and the first three seeds that it would fly."""

    def run_campaign(*words: str) -> tuple[Result, list[int]]:
        seeds: list[int] = []

        def fly(chosen: Iterable[int], *args: Any) -> Iterator[MissionReport]:
            for seed in islice(chosen, 3):
                seeds.append(seed)
                yield flown_well(seed)

        monkeypatch.setattr(flown, "fly_campaign", fly)
        monkeypatch.chdir(tmp_path)
        return CliRunner().invoke(campaign, words), seeds

    return run_campaign


def commit_in(folder: Path) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run(("git", "init", "-q"), cwd=folder, check=True)
    subprocess.run(("git", *who, "commit", "-q", "--allow-empty", "-m", "first"), cwd=folder, check=True)
    head = subprocess.run(("git", "rev-parse", "HEAD"), cwd=folder, check=True, capture_output=True, text=True)
    return head.stdout.strip()


def test_a_commit_has_seeds_of_its_own_and_they_are_told(run: Run, tmp_path: Path) -> None:
    commit = commit_in(tmp_path)
    first = first_seed(commit)
    result, seeds = run("--commit", "HEAD", "--minutes", "3")
    assert seeds == [first, first + 1, first + 2]
    assert f"seeds of commit {commit[:12]}: {first}, {first + 1}, " in result.output
    assert first_seed(HASH) != first_seed(HASH[::-1])


def test_a_whole_hash_needs_no_checkout(run: Run) -> None:
    assert run("--commit", HASH, "--minutes", "3")[1][0] == first_seed(HASH)


def test_outside_a_checkout_the_seeds_begin_at_0_and_it_says_so(run: Run) -> None:
    result, seeds = run("--commit", "HEAD", "--minutes", "3")
    assert seeds == [0, 1, 2]
    assert "no commit HEAD here" in result.output and "not a git repository" in result.output


def test_a_commit_that_is_not_there_is_refused(run: Run, tmp_path: Path) -> None:
    commit_in(tmp_path)
    result, seeds = run("--commit", "nonsense", "--minutes", "3")
    assert (result.exit_code, seeds) == (2, [])
    assert "no commit nonsense" in result.output


@pytest.mark.parametrize("words", [("--commit", "HEAD"), ("--commit", "HEAD", "--minutes", "3", "--seeds", "1..2")])
def test_a_commit_takes_the_place_of_seeds_and_needs_a_time(run: Run, words: tuple[str, ...]) -> None:
    assert run(*words)[0].exit_code == 2


def test_no_mission_begins_after_the_time_is_over() -> None:
    assert list(seeds_for_minutes(iter(range(10)), 0.0)) == [0]
    assert list(seeds_for_minutes(range(10), 60.0)) == list(range(10))


@pytest.mark.parametrize("faults", ["0..3", "14..3", "3..201", "many", "3.."])
def test_a_wrong_number_of_faults_is_refused_with_what_to_write(run: Run, faults: str) -> None:
    result, seeds = run("--faults", faults)
    assert (result.exit_code, seeds) == (2, [])
    assert "or one number" in result.output or "1 to 200 faults" in " ".join(result.output.split())


def test_both_ends_of_a_range_are_flown(run: Run) -> None:
    assert run("--seeds", "7..9")[1] == [7, 8, 9]


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_what_was_flown_until_it_is_interrupted_is_summed_up(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    def fly(*args: Any) -> Iterator[MissionReport]:
        yield flown_well(4)
        yield flown_well(5)
        raise KeyboardInterrupt

    monkeypatch.setattr(flown, "fly_campaign", fly)
    result = CliRunner().invoke(campaign, ("--seeds", "4..9", *words))
    assert result.exit_code == 1
    if words:
        told = json.loads(result.stdout.splitlines()[-1])
        assert (told["seeds"], told["faults"]["drop"], told["states"]["HOVER"]) == (2, 4, 2)
    else:
        assert "2 missions, 1.00 h of flight; failed: none" in result.output


def test_a_mission_that_breaks_a_rule_is_flown_once_more_with_a_recording(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(TruthJudge, "__call__", _violation_at_once)
    words = ["--seeds", "5", "--model", "point-mass", "--recordings", str(tmp_path), "--json"]
    result = CliRunner().invoke(campaign, words)
    report = json.loads(result.output.splitlines()[0])
    path = tmp_path / "point-mass-5" / "flight.mcap"
    assert report["violations"] and report["recording"] == str(path)
    summary = open_recording(path).summary()
    assert (summary.about["seed"], summary.about["model"], summary.problem) == ("5", "point-mass", "")
    assert summary.counts["status"] > 0
    assert summary.end_ns / 1e9 == pytest.approx(report["sim_time_s"], abs=0.5)


def _violation_at_once(judge: Any, t_ns: int, topic: str, data: bytes) -> None:
    judge._judge.check(False, t_ns, "always", "made up")
