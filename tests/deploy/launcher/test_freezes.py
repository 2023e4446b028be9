"""Which processes count as frozen, and which are only slow, starved, or out of reach."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero.deploy.launcher.freezes import LOOK_PERIOD_S, FreezeWatch, Look, look_at

PID = 7


def look(*, stopped: bool = False, waited_s: float = 0.0, signs: int = 0, reachable: bool = True) -> Look:
    return Look(stopped=stopped, waited_s=waited_s, signs=signs, reachable=reachable)


def test_a_stopped_process_is_frozen_within_two_seconds_at_the_latest() -> None:
    watch = FreezeWatch()
    assert watch.judge(0.0, {PID: look()}) == {}
    for number in range(1, 6):  # stopped right after the first look
        assert watch.judge(LOOK_PERIOD_S * number, {PID: look(stopped=True)}) == {}
    assert watch.judge(1.5, {PID: look(stopped=True)}) == {PID: "stopped for 1.50 s"}


def test_a_process_that_goes_on_after_a_short_stop_is_left_alone() -> None:
    watch = FreezeWatch()
    for number in range(40):
        stopped = number % 6 != 0  # 1.25 s of each 1.5 s
        assert watch.judge(LOOK_PERIOD_S * number, {PID: look(stopped=stopped, signs=number)}) == {}


def test_time_in_which_the_launcher_did_not_run_counts_for_nobody() -> None:
    watch = FreezeWatch()
    watch.judge(0.0, {PID: look()})
    assert watch.judge(3600.0, {PID: look()}) == {}
    assert watch.judge(7200.0, {PID: look(stopped=True)}) == {}  # stopped together with the launcher a moment ago
    assert watch.judge(7200.25, {PID: look(stopped=False)}) == {}


def silence(watch: FreezeWatch, seconds: int, waited_share: float = 0.0, reachable: bool = True) -> dict[int, str]:
    """What is told at the end of so many seconds without a sign."""
    told: dict[int, str] = {}
    for number in range(seconds * 4 + 1):
        at_s = LOOK_PERIOD_S * number
        told = watch.judge(at_s, {PID: look(waited_s=waited_share * at_s, reachable=reachable)})
    return told


def test_a_process_on_the_bus_that_makes_no_report_for_ten_seconds_is_frozen() -> None:
    assert silence(FreezeWatch(), 9) == {}
    assert "no report for 10.0 s" in silence(FreezeWatch(), 10)[PID]


def test_a_process_that_waits_for_a_processor_is_starved_and_not_frozen() -> None:
    assert silence(FreezeWatch(), 99, waited_share=0.9) == {}


def test_a_process_that_the_bus_cannot_reach_is_left_alone_and_has_time_to_report_afterwards() -> None:
    watch = FreezeWatch()
    assert silence(watch, 99, reachable=False) == {}
    assert watch.judge(99.25, {PID: look(reachable=True)}) == {}


def test_a_successor_starts_with_a_clean_slate() -> None:
    watch = FreezeWatch()
    for number in range(7):
        watch.judge(LOOK_PERIOD_S * number, {PID: look(stopped=True)})
    assert watch.judge(2.0, {PID + 1: look(stopped=True)}) == {}


@pytest.fixture
def sleeper() -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(["sleep", "1000"])
    yield process
    process.kill()
    process.wait()


def test_a_stopped_process_is_seen_in_the_kernels_table(sleeper: "subprocess.Popen[bytes]") -> None:
    assert not look_at(sleeper.pid, signs=0, reachable=False).stopped
    os.kill(sleeper.pid, signal.SIGSTOP)
    deadline = time.monotonic() + 5.0
    while not look_at(sleeper.pid, signs=0, reachable=False).stopped:
        assert time.monotonic() < deadline
    os.kill(sleeper.pid, signal.SIGCONT)
    while look_at(sleeper.pid, signs=0, reachable=False).stopped:
        assert time.monotonic() < deadline


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="this kernel keeps no scheduler statistics")
def test_waiting_for_a_processor_is_counted_by_the_kernel() -> None:
    """Two processes that share one processor each wait for about half of the time."""
    cpu = min(os.sched_getaffinity(0))
    spinners = [subprocess.Popen(["sh", "-c", "while :; do :; done"]) for _ in range(2)]
    try:
        for spinner in spinners:
            os.sched_setaffinity(spinner.pid, {cpu})
        deadline = time.monotonic() + 20.0
        while look_at(spinners[0].pid, signs=0, reachable=False).waited_s < 0.1:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()
