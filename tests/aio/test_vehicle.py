"""The asyncio client against a real router and hand-made servers, on a free loopback port."""

import asyncio
import inspect
from collections.abc import Awaitable, Callable

import pytest

from jezero import aio
from jezero.aio import TimedOut, Unreachable, Vehicle
from jezero.client import camera, goal, images, rover, subscription
from jezero.client import vehicle as client
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Result
from jezero.schemas.commands import RoverCommand
from tests.aio.rig import TAKEOFF, asked, clock, odometry, with_vehicle
from tests.client.rig import (
    ACCEPTED,
    Server,
    a_result,
    a_status,
    endpoint,
    published,
    server,
    wait_until_subscribed,
)
from tests.client.test_images import IMAGES, feedback, pixels_of, result, serve_pictures

__all__ = ["endpoint", "server"]


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


@pytest.mark.parametrize("ends_with", [None, asyncio.CancelledError])
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
