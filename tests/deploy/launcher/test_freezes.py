"""Which processes count as frozen, and which are only slow, starved, or out of reach."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero.deploy.launcher.freezes import SAMPLE_PERIOD_S, FreezeDetector, ProcessSample, sample_process

PID, OTHER_PID = 7, 8


def sample(*, stopped: bool = False, waited_s: float = 0.0, reports: int = 0, reachable: bool = True) -> ProcessSample:
    return ProcessSample(stopped=stopped, waited_s=waited_s, reports=reports, reachable=reachable)


def test_a_stopped_process_is_frozen_within_two_seconds_at_the_latest() -> None:
    detector = FreezeDetector()
    assert detector.update(0.0, {PID: sample()}) == {}
    for number in range(1, 6):  # stopped right after the first sample
        assert detector.update(SAMPLE_PERIOD_S * number, {PID: sample(stopped=True)}) == {}
    assert detector.update(1.5, {PID: sample(stopped=True)}) == {PID: "stopped for 1.50 s"}


def test_a_process_that_goes_on_after_a_short_stop_is_left_alone() -> None:
    detector = FreezeDetector()
    for number in range(40):
        stopped = number % 6 != 0  # 1.25 s of each 1.5 s
        assert detector.update(SAMPLE_PERIOD_S * number, {PID: sample(stopped=stopped, reports=number)}) == {}


def test_time_in_which_the_launcher_did_not_run_counts_for_nobody() -> None:
    detector = FreezeDetector()
    detector.update(0.0, {PID: sample()})
    assert detector.update(3600.0, {PID: sample()}) == {}
    assert detector.update(7200.0, {PID: sample(stopped=True)}) == {}  # stopped together with the launcher a moment ago
    assert detector.update(7200.25, {PID: sample(stopped=False)}) == {}


def silence(
    detector: FreezeDetector, seconds: int, waited_share: float = 0.0, reachable: bool = True
) -> dict[int, str]:
    """Frozen processes after a time in s without a report of one service, while another one reports once a second."""
    frozen: dict[int, str] = {}
    for number in range(seconds * 4 + 1):
        at_s = SAMPLE_PERIOD_S * number
        silent = sample(waited_s=waited_share * at_s, reachable=reachable)
        frozen = detector.update(at_s, {PID: silent, OTHER_PID: sample(reports=number // 4)})
    return frozen


def test_a_silence_of_all_services_at_once_is_the_fault_of_the_bus_and_kills_none_of_them() -> None:
    detector = FreezeDetector()
    for number in range(400):
        assert detector.update(SAMPLE_PERIOD_S * number, {PID: sample(), OTHER_PID: sample()}) == {}
    for number in range(400, 440):  # the bus is back, and each service has its full time to report
        others = {PID: sample(), OTHER_PID: sample(reports=number // 4)}
        frozen = detector.update(SAMPLE_PERIOD_S * number, others)
        assert frozen == {} or number > 430
    assert list(frozen) == [PID]


def test_a_process_on_the_bus_that_makes_no_report_for_ten_seconds_is_frozen() -> None:
    assert silence(FreezeDetector(), 9) == {}
    assert "no report for 10.0 s" in silence(FreezeDetector(), 10)[PID]


def test_a_process_that_waits_for_a_processor_is_starved_and_not_frozen() -> None:
    assert silence(FreezeDetector(), 99, waited_share=0.9) == {}


def test_a_process_that_the_bus_cannot_reach_is_left_alone_and_has_time_to_report_afterwards() -> None:
    detector = FreezeDetector()
    assert silence(detector, 99, reachable=False) == {}
    assert detector.update(99.25, {PID: sample(reachable=True)}) == {}


def test_a_successor_starts_with_a_clean_slate() -> None:
    detector = FreezeDetector()
    for number in range(7):
        detector.update(SAMPLE_PERIOD_S * number, {PID: sample(stopped=True)})
    assert detector.update(2.0, {PID + 1: sample(stopped=True)}) == {}


@pytest.fixture
def sleeper() -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(["sleep", "1000"])
    yield process
    process.kill()
    process.wait()


def test_a_stopped_process_is_seen_in_the_kernels_table(sleeper: "subprocess.Popen[bytes]") -> None:
    assert not sample_process(sleeper.pid, reports=0, reachable=False).stopped
    os.kill(sleeper.pid, signal.SIGSTOP)
    deadline = time.monotonic() + 5.0
    while not sample_process(sleeper.pid, reports=0, reachable=False).stopped:
        assert time.monotonic() < deadline
    os.kill(sleeper.pid, signal.SIGCONT)
    while sample_process(sleeper.pid, reports=0, reachable=False).stopped:
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
        while sample_process(spinners[0].pid, reports=0, reachable=False).waited_s < 0.1:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()
