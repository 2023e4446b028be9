"""A program with asyncio flies over real processes."""

import asyncio

import pytest

from jezero.aio import Canceled, Vehicle
from jezero.schemas import topics
from tests.system.conftest import Stack


@pytest.mark.long
def test_a_program_with_asyncio_takes_off_and_stops_a_flight(stack: Stack) -> None:
    altitudes_m: list[float] = []

    async def follow(uav: Vehicle) -> None:
        async for odometry in uav.subscribe(topics.ODOMETRY):
            altitudes_m.append(-odometry.pos_uav_ned_m[2])

    async def fly() -> None:
        async with await Vehicle.connect(stack.instance.vehicle, router=stack.instance.router) as uav:
            following = asyncio.create_task(follow(uav))
            goal = await uav.takeoff(altitude_m=2.0)
            distances_m = [feedback.distance_m async for feedback in goal]
            assert (await goal.result()).completed
            assert len(distances_m) > 10 and distances_m[-1] < distances_m[0]
            assert max(altitudes_m) > 1.7

            far = await uav.go_to(50.0, 0.0, -5.0, speed_mps=1.0)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.0):  # which cancels the goal, as it cancels the wait for it
                    await far.result()
            with pytest.raises(Canceled):
                await far.result()
            following.cancel()

    asyncio.run(asyncio.wait_for(fly(), 120.0))
