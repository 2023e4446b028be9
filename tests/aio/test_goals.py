"""Goals of the asyncio client, against a real router and hand-made servers, on a free loopback port."""

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from jezero import aio
from jezero.aio import Aborted, Canceled, Goal, Refused, TimedOut, Unreachable, Vehicle
from jezero.schemas.actions import Accepted, CancelReply, Rejected
from jezero.schemas.commands import AbortReply
from jezero.schemas.goals import MoveResult
from tests.aio.rig import CANCEL, TAKEOFF, asked, happens, with_vehicle
from tests.client.rig import (
    ACCEPTED,
    POINT,
    Server,
    a_feedback,
    a_result,
    endpoint,
    server,
)
from tests.client.test_images import result

__all__ = ["endpoint", "server"]


def test_a_goal_yields_its_feedback_and_returns_its_result(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, a_feedback(2.0), a_feedback(1.0), a_result())

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff(altitude_m=2.0)
        assert (goal.goal_id, goal.warning, goal.code) == ("g", "careful", None)
        assert [feedback.distance_m async for feedback in goal] == [2.0, 1.0]
        assert goal.code == 1
        assert await goal.result() == MoveResult(completed=True, pos_uav_ned_m=POINT)
        assert await goal.result(timeout_s=0.0) == await goal.result()
        assert await goal.next_feedback() is None
        assert repr(goal) == "<takeoff goal g: succeeded>"

    with_vehicle(endpoint, server, test)


def test_a_refusal_and_an_unhappy_end_raise_the_errors_of_the_blocking_client(server: Server, endpoint: str) -> None:
    server.serve("@action/go_to", Rejected(goal_id="g", reason="it flies already", code=3))
    server.serve(TAKEOFF, ACCEPTED, a_result("aborted", "because"))

    async def test(uav: Vehicle) -> None:
        with pytest.raises(Refused, match="it flies already") as refusal:
            await uav.go_to(0.0, 0.0, -3.0)
        assert refusal.value.code == 3
        goal = await uav.takeoff()
        with pytest.raises(Aborted, match="because") as aborted:
            await goal.result()
        assert aborted.value.result == MoveResult(completed=False, pos_uav_ned_m=POINT)
        with pytest.raises(ValueError, match="there is no action 'flyy'"):
            await uav.send("flyy")
        with pytest.raises(Unreachable, match="no server replies on @action/land_on_spot"):
            await uav.land_on_spot()

    with_vehicle(endpoint, server, test)


def test_any_action_is_sent_and_planned_by_its_name(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, a_result())
    server.serve("@action/get_images", Accepted(goal_id="g"), result())

    async def test(uav: Vehicle) -> None:
        assert (await (await uav.send("takeoff", altitude_m=3.0)).result()).completed
        assert server.asked[-1][2]["altitude_m"] == 3.0
        sent = await uav.send("get_images", center_ned_m=POINT, radius_m=1.0, num_images=2)
        assert isinstance(sent, aio.ImagesGoal)

    with_vehicle(endpoint, server, test)


def test_other_tasks_run_while_a_goal_is_waited_for(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, end=False)

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff()
        waiting = asyncio.create_task(goal.next_feedback())
        ticks = 0
        for _ in range(10):
            await asyncio.sleep(0.001)
            ticks += 1
        assert (ticks, waiting.done()) == (10, False)
        (query,) = server.open.pop(TAKEOFF)
        server.reply(query, a_feedback(5.0))
        feedback = await waiting
        assert feedback is not None and feedback.distance_m == 5.0

    with_vehicle(endpoint, server, test)


def test_an_abort_is_sent_at_once_however_many_tasks_wait(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, end=False)
    server.serve(CANCEL, CancelReply(canceled=True))
    server.serve("@control/abort", AbortReply(hovering=True))

    async def test(uav: Vehicle) -> None:
        goals = [await uav.takeoff() for _ in range(100)]
        waits = [asyncio.create_task(goal.result()) for goal in goals]
        waits += [asyncio.create_task(stream.next()) for stream in [uav.subscribe("odometry") for _ in range(100)]]
        await asyncio.sleep(0)
        start_s = time.monotonic()
        assert (await uav.abort("enough")).hovering
        assert time.monotonic() - start_s < 1.0
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)
        assert asked(server).count(CANCEL) == 100

    with_vehicle(endpoint, server, test)


# -- time-outs and cancellations --


def test_a_wait_that_times_out_leaves_the_goal_running(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, end=False)

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff()
        with pytest.raises(TimedOut, match=r"takeoff still runs after 0.05 s"):
            await goal.result(timeout_s=0.05)
        with pytest.raises(TimedOut):
            await goal.next_feedback(timeout_s=0.05)
        assert CANCEL not in asked(server)
        (query,) = server.open.pop(TAKEOFF)
        server.reply(query, a_result())
        assert (await goal.result(timeout_s=2.0)).completed

    with_vehicle(endpoint, server, test)


async def wait_for_result(goal: Goal[Any, Any]) -> None:
    await goal.result()


async def iterate(goal: Goal[Any, Any]) -> None:
    async for _ in goal:
        pass


@pytest.mark.parametrize("wait", [wait_for_result, iterate])
def test_a_canceled_task_cancels_the_goal_that_it_waits_for(
    server: Server, endpoint: str, wait: Callable[[Goal[Any, Any]], Awaitable[None]]
) -> None:
    server.serve(TAKEOFF, ACCEPTED, a_feedback(1.0), end=False)
    server.serve(CANCEL, CancelReply(canceled=True))

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await wait(goal)
        assert server.asked[-1] == (CANCEL, server.asked[-1][1], {"goal_id": "g"})
        (query,) = server.open.pop(TAKEOFF)
        server.reply(query, a_result("canceled"))
        with pytest.raises(Canceled):
            await goal.result()

    with_vehicle(endpoint, server, test)


def test_a_loop_over_feedback_that_is_left_leaves_the_goal_running(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, a_feedback(1.0), a_feedback(0.5), a_result())

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff()
        async for _ in goal:
            break
        assert (await goal.result()).completed
        assert CANCEL not in asked(server)

    with_vehicle(endpoint, server, test)


def test_a_goal_that_is_accepted_after_its_task_was_canceled_is_canceled(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, end=False)
    server.serve(CANCEL, CancelReply(canceled=True))

    async def test(uav: Vehicle) -> None:
        sending = asyncio.create_task(uav.takeoff())
        await happens(lambda: server.open.get(TAKEOFF))
        sending.cancel()
        await asyncio.sleep(0)
        (query,) = server.open.pop(TAKEOFF)
        server.reply(query, ACCEPTED)
        with pytest.raises(asyncio.CancelledError):
            await sending
        assert server.asked[-1][::2] == (CANCEL, {"goal_id": "g"})

    with_vehicle(endpoint, server, test)


PROGRAM = """
import asyncio, sys
from jezero.aio import Vehicle
async def main():
    async with await Vehicle.connect("v", router=sys.argv[1]) as uav:
        goal = await uav.takeoff()
        print("accepted", flush=True)
        await goal.result()
asyncio.run(main())
"""


def test_ctrl_c_cancels_the_goal_before_the_program_ends(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, end=False)
    server.serve(CANCEL, CancelReply(canceled=True))
    command = [sys.executable, "-c", PROGRAM, endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "accepted\n"
        start_s = time.monotonic()
        program.send_signal(signal.SIGINT)
        _, err = program.communicate(timeout=10)
    assert time.monotonic() - start_s < 2.0
    assert "KeyboardInterrupt" in err
    assert asked(server)[-1] == CANCEL


# -- lost servers and connections --
