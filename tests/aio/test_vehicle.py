"""The asyncio client against a real router and hand-made servers, on a free loopback port."""

import asyncio
import inspect
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from jezero import aio
from jezero.aio import Aborted, Canceled, Goal, Refused, TimedOut, Unreachable, Vehicle
from jezero.client import camera, goal, images, rover, subscription
from jezero.client import vehicle as client
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, CancelReply, ModifyReply, PauseReply, Rejected, Result, ResumeReply
from jezero.schemas.commands import AbortReply, RoverCommand
from jezero.schemas.goals import MoveResult
from jezero.schemas.state import Clock, Odometry
from tests.client.rig import (
    ACCEPTED,
    ODOMETRY,
    POINT,
    Server,
    a_feedback,
    a_result,
    a_status,
    close,
    endpoint,
    own_stack,
    published,
    server,
    wait_until_subscribed,
)
from tests.client.test_images import IMAGES, feedback, pixels_of, result, serve_pictures

__all__ = ["endpoint", "server"]
TAKEOFF = "@action/takeoff"
CANCEL = "@action/takeoff/cancel"


@asynccontextmanager
async def connected(endpoint: str, server: Server) -> AsyncIterator[Vehicle]:
    """A connection to vehicle `v`; a server that is declared later is known to it at once."""
    async with await Vehicle.connect("v", router=endpoint) as uav:
        server.clients.append(uav._blocking._connection._session)
        yield uav


def with_vehicle(endpoint: str, server: Server, test: Callable[[Vehicle], Awaitable[None]]) -> None:
    """Run a test in an event loop with a connected vehicle."""

    async def run() -> None:
        async with asyncio.timeout(20), connected(endpoint, server) as uav:
            await test(uav)

    asyncio.run(run())


async def happens(condition: Callable[[], object], timeout_s: float = 3.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.005)


def asked(server: Server) -> list[str]:
    return [name for name, _, _ in server.asked]


def odometry(t_ns: int) -> Odometry:
    return msgspec.structs.replace(ODOMETRY, t_ns=t_ns)


def clock(t_ns: int) -> Clock:
    return Clock(t_ns=100_000_000 * t_ns, epoch_id=1, wall_ns=t_ns)


# -- goals --


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


def test_a_goal_is_paused_modified_and_resumed(server: Server, endpoint: str) -> None:
    server.serve(TAKEOFF, ACCEPTED, end=False)
    server.serve(f"{TAKEOFF}/pause", PauseReply(paused=True))
    server.serve(f"{TAKEOFF}/modify", ModifyReply(modified=True, warning="lower than asked"))
    server.serve(f"{TAKEOFF}/resume", ResumeReply(resumed=False, reason="goal g is not paused"))

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff()
        await goal.pause()
        await goal.modify(altitude_m=3.0)
        assert goal.warning == "lower than asked"
        with pytest.raises(Refused, match="goal g is not paused"):
            await goal.resume()

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
import asyncio, signal, sys
from jezero.aio import Vehicle
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in a shell's background
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


def test_a_server_that_dies_is_noticed_while_the_loop_runs_on(
    server: Server, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jezero.client.goal.POLL_S", 0.05)
    other = Server(endpoint)
    other.serve(TAKEOFF, ACCEPTED, end=False)
    server.serve("@action/result", complete=False)

    async def test(uav: Vehicle) -> None:
        goal = await uav.takeoff()
        other.close()
        with pytest.raises(Unreachable, match="the takeoff server died or lost its router; the vehicle hovers"):
            await goal.result()

    with_vehicle(endpoint, server, test)


def test_a_lost_router_ends_the_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.client.goal.RECOVER_S", 0.5)
    with own_stack() as (endpoint, router, server):
        server.serve(TAKEOFF, ACCEPTED, end=False)

        async def test(uav: Vehicle) -> None:
            goal = await uav.takeoff()
            close(router)
            with pytest.raises(Unreachable, match=r"connection to the router .* is lost; goal g may still run"):
                await goal.result()

        with_vehicle(endpoint, server, test)


def test_without_a_router_connecting_says_so_in_time() -> None:
    with pytest.raises(Unreachable, match=r"no router at tcp/127.0.0.1:1 within 0.2 s"):
        asyncio.run(Vehicle.connect("v", router="tcp/127.0.0.1:1", timeout_s=0.2))


async def drive(uav: Vehicle) -> None:
    await uav.rover.drive(0.5)


async def read_topic(uav: Vehicle) -> None:
    async for _ in uav.subscribe(topics.UWB):
        pass


async def watch(uav: Vehicle) -> None:
    async for _ in uav.watch_status():
        pass


async def take_off(uav: Vehicle) -> None:
    await (await uav.takeoff()).result()


@pytest.mark.parametrize("wait", [drive, read_topic, watch, take_off])
def test_closing_the_connection_ends_every_wait_with_that_reason(
    server: Server, endpoint: str, wait: Callable[[Vehicle], Awaitable[None]]
) -> None:
    server.serve("status", a_status())
    server.serve(TAKEOFF, ACCEPTED, end=False)

    async def test(uav: Vehicle) -> None:
        waiting = asyncio.ensure_future(wait(uav))
        await asyncio.wait([waiting], timeout=0.3)
        await uav.close()
        with pytest.raises(Unreachable, match="the connection to v was closed"):
            await waiting
        with pytest.raises(Unreachable, match="the connection to v was closed"):
            await wait(uav)

    with published(server, clock, topics.CLOCK):
        with_vehicle(endpoint, server, test)


# -- telemetry --


def test_a_subscription_yields_every_message_in_order(server: Server, endpoint: str) -> None:
    async def test(uav: Vehicle) -> None:
        times_ns: list[int] = []
        async with uav.subscribe(topics.ODOMETRY) as stream:
            async for message in stream:
                times_ns.append(message.t_ns)
                if len(times_ns) == 5:
                    break
        assert times_ns == list(range(times_ns[0], times_ns[0] + 5))
        assert [message async for message in stream] == []

    with published(server, odometry, topics.ODOMETRY):
        with_vehicle(endpoint, server, test)


def test_a_wait_for_a_message_that_is_canceled_takes_none_away(server: Server, endpoint: str) -> None:
    async def test(uav: Vehicle) -> None:
        stream = uav.subscribe(topics.ODOMETRY)
        for _ in range(20):
            waiting = asyncio.create_task(stream.next())
            await asyncio.sleep(0)
            waiting.cancel()
        with pytest.raises(TimedOut, match=r"no message on odometry of v for 0.05 s: is its service up\?"):
            await stream.next(0.05)
        wait_until_subscribed(server.session, topics.key("v", "odometry"))
        server.publish(topics.ODOMETRY, odometry(7))
        assert (await stream.next(3.0)).t_ns == 7

    with_vehicle(endpoint, server, test)


def test_the_latest_values_are_those_of_the_blocking_client(server: Server, endpoint: str) -> None:
    async def test(uav: Vehicle) -> None:
        assert (await uav.odometry(3.0)).pos_uav_ned_m == ODOMETRY.pos_uav_ned_m
        assert (await uav.latest(topics.ODOMETRY)).t_ns <= (await uav.latest("odometry")).t_ns
        with pytest.raises(TimedOut, match="no message on estimate/relative"):
            await uav.relative(timeout_s=0.05)

    with published(server, odometry, topics.ODOMETRY):
        with_vehicle(endpoint, server, test)


def test_status_is_watched(server: Server, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.aio.vehicle.STATUS_TIMEOUT_S", 0.5)
    server.serve("status", a_status(t_ns=1))

    async def test(uav: Vehicle) -> None:
        assert (await uav.wait_ready()).t_ns == 1
        stream = uav.watch_status()
        assert (await anext(stream)).t_ns == 1
        with published(server, lambda t_ns: a_status(t_ns=t_ns)):
            first = (await anext(stream)).t_ns
            assert (await anext(stream)).t_ns == first + 1
        with pytest.raises(Unreachable, match="no status of v for"):
            while True:
                await anext(stream)

    with_vehicle(endpoint, server, test)


def test_pictures_come_once_each(server: Server, endpoint: str) -> None:
    replies = (feedback(1, IMAGES[0]), feedback(2, IMAGES[1]))
    server.serve("@action/get_images", Accepted(goal_id="g"), *replies, result(*IMAGES))
    serve_pictures(server)

    async def test(uav: Vehicle) -> None:
        taken: list[int] = []
        goal = await uav.get_images((0.0, 0.0, -4.0), 2.0, 3)
        pixels = [picture.pixels async for picture in goal.pictures(lambda feedback: taken.append(feedback.taken))]
        assert (pixels, taken) == ([pixels_of(0), pixels_of(1), pixels_of(2)], [1, 2])

    with_vehicle(endpoint, server, test)


def test_without_a_camera_a_snap_says_so(server: Server, endpoint: str, tmp_path: Path) -> None:
    async def test(uav: Vehicle) -> None:
        with pytest.raises(Unreachable, match=r"no image of v within 0.1 s"):
            await uav.camera.snap(tmp_path / "x.png", timeout_s=0.1)

    with_vehicle(endpoint, server, test)


# -- the rover, and a flight --


async def until_stopped(commands: aio.Subscription[RoverCommand]) -> list[float]:
    speeds_mps = [0.5]
    while speeds_mps[-1]:
        speeds_mps.append((await commands.next(3.0)).speed_rover_body_mps)
    return speeds_mps


def test_a_canceled_drive_stops_the_rover(server: Server, endpoint: str) -> None:
    async def test(uav: Vehicle) -> None:
        async with uav.subscribe(topics.ROVER_COMMAND) as commands:
            task = asyncio.create_task(uav.rover.drive(0.5))
            assert (await commands.next(3.0)).speed_rover_body_mps == 0.5
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert set(await until_stopped(commands)) == {0.5, 0.0}

    with published(server, clock, topics.CLOCK):
        with_vehicle(endpoint, server, test)


def test_driving_goes_on_beside_the_block_and_stops_with_it(server: Server, endpoint: str) -> None:
    async def test(uav: Vehicle) -> None:
        async with uav.subscribe(topics.ROVER_COMMAND) as commands:
            async with uav.rover.driving(0.5, 0.1):
                command = await commands.next(3.0)
                assert (command.speed_rover_body_mps, command.yaw_rate_rover_rps) == (0.5, 0.1)
            await until_stopped(commands)
        await uav.rover.drive(0.5, for_s=0.3)
        with pytest.raises(ValueError, match="not within ±2"):
            await uav.rover.drive(3.0)
        with pytest.raises(ValueError, match="not within ±2"):
            async with uav.rover.driving(3.0):
                pass

    with published(server, clock, topics.CLOCK):
        with_vehicle(endpoint, server, test)


@pytest.mark.parametrize("ends_with", [None, KeyError, asyncio.CancelledError])
def test_a_flight_lands_however_its_block_ends(
    server: Server, endpoint: str, ends_with: type[BaseException] | None
) -> None:
    server.serve("status", a_status())
    server.serve(TAKEOFF, ACCEPTED, a_result())
    landed = Result(goal_id="g", t_ns=2, outcome="succeeded", result={"completed": True, "touchdown_ned_m": None})
    server.serve("@action/land_on_spot", ACCEPTED, landed)

    async def fly(uav: Vehicle) -> None:
        async with uav.flight(altitude_m=3.0) as same:
            assert same is uav
            if ends_with is not None:
                raise ends_with

    async def test(uav: Vehicle) -> None:
        flying = asyncio.create_task(fly(uav))
        await asyncio.wait([flying])
        if ends_with is None:
            flying.result()
        else:
            with pytest.raises(ends_with):
                flying.result()
        assert [name for name in asked(server) if name.startswith("@action")] == [TAKEOFF, "@action/land_on_spot"]

    with_vehicle(endpoint, server, test)


# -- the same as the blocking client --

PAIRS = [
    (client.Vehicle, aio.Vehicle),
    (goal.Goal, aio.Goal),
    (images.ImagesGoal, aio.ImagesGoal),
    (rover.Rover, aio.Rover),
    (camera.Camera, aio.Camera),
    (subscription.Subscription, aio.Subscription),
]
NOT_NEEDED = {("subscribe", "callback"), ("follow", "on_leg")}
"""Parameters that a task does without."""


@pytest.mark.parametrize(("blocking", "asynchronous"), PAIRS, ids=lambda cls: cls.__module__)
def test_every_method_has_the_parameters_and_a_docstring_as_in_the_blocking_client(
    blocking: type, asynchronous: type
) -> None:
    for name, method in inspect.getmembers(blocking, callable):
        if name.startswith("_"):
            continue
        other = getattr(asynchronous, name)
        wanted = [p for p in parameters(method) if (name, p[0]) not in NOT_NEEDED]
        assert parameters(other) == wanted, name
        assert inspect.getdoc(other), name


def parameters(method: Callable[..., object]) -> list[tuple[str, str, bool]]:
    """Name and kind of each parameter, and whether it has a default."""
    return [(p.name, p.kind.name, p.default is p.empty) for p in inspect.signature(method).parameters.values()]
