"""An area is planned in a process of its own, which may hang or die: the server and the vehicle don't care."""

import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from jezero import Refused, Vehicle
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, CancelReply
from tests.system.conftest import ProcessorWait, Stack, wait_for

FIELD = ((0.0, 0.0), (0.0, 6.0), (6.0, 6.0), (6.0, 0.0))


def children(pid: int) -> list[int]:
    """Ids of the processes that a service has started."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(entry.read_text().rpartition(")")[2].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            continue
        if parent == pid:
            found.append(int(entry.parent.name))
    return found


@contextmanager
def planning(server: int, vehicle: Vehicle) -> Iterator[tuple[Future[Any], int, str]]:
    """A goal whose planning has been stopped by a signal: the goal, the process that plans it, and its id."""
    ids: list[str] = []
    topic = topics.feedback_of(topics.AREA_COVERAGE)
    with vehicle.subscribe(topic) as feedback, ThreadPoolExecutor() as pool:
        goal = pool.submit(vehicle.area_coverage, FIELD, -5.0, resolution_m=1.0)
        wait_for(lambda: children(server), 10.0, "a process that plans")
        (planner,) = children(server)
        os.kill(planner, signal.SIGSTOP)
        message = next(iter(feedback))
        assert message.feedback.phase == "planning"
        ids.append(message.goal_id)
        yield goal, planner, ids[0]


@pytest.mark.long
@pytest.mark.whole
def test_a_goal_whose_planner_hangs_is_canceled_at_once_and_one_whose_planner_dies_is_refused(stack: Stack) -> None:
    server = stack.processes_cached["area_coverage"]
    with stack.connect() as vehicle:
        vehicle.takeoff(altitude_m=3.0).result()
        with planning(server, vehicle) as (goal, _, goal_id):
            waited = ProcessorWait(stack.processes_cached.values())
            asked_s = time.monotonic()
            with pytest.raises(Refused, match="busy"):
                vehicle.area_coverage(FIELD, -5.0, resolution_m=1.0)
            vehicle.hover()
            assert not goal.done()
            assert time.monotonic() - asked_s < 1.0 + waited.seconds()
            waited = ProcessorWait(stack.processes_cached.values())
            asked_s = time.monotonic()
            reply = vehicle._connection.request(topics.AREA_COVERAGE.cancel, Cancel(goal_id=goal_id), 2.0)
            assert reply == CancelReply(canceled=True)
            assert "canceled by a client" in str(goal.exception(timeout=5.0))
            assert time.monotonic() - asked_s < 0.2 + waited.seconds()
        wait_for(lambda: not children(server), 2.0, "the end of the process that hung")
        with planning(server, vehicle) as (goal, planner, _):
            os.kill(planner, signal.SIGKILL)
            assert "failed in prepare: its process ended with SIGKILL" in str(goal.exception(timeout=5.0))
        plan = vehicle.plan("area_coverage", polygon_ned_m=FIELD, z_ned_m=-5.0, resolution_m=1.0)
        assert plan.accepted
        assert stack.processes()["area_coverage"] == server
