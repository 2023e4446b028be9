"""Flights by velocity of both clients, against a real router and a hand-made server."""

import asyncio
from math import nan

import pytest

from jezero import Aborted, Refused, TimedOut, Vehicle, aio
from jezero.client.velocity import VelocityGoal
from jezero.schemas.actions import CancelReply
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.goals import VelocityResult
from tests.aio.rig import with_vehicle
from tests.client.rig import ACCEPTED, POINT, Server, a_result, endpoint, server, steerable, vehicle, velocity_feedback

__all__ = ["endpoint", "server", "vehicle"]
RESULT = VelocityResult(completed=True, pos_uav_ned_m=POINT)


def fields_of(command: VelocityCommand) -> tuple[str, float, float, float, float, bool]:
    return (
        command.goal_id,
        command.forward_mps,
        command.right_mps,
        command.up_mps,
        command.yaw_rate_rps,
        command.is_last,
    )


def test_commands_carry_the_goal_and_vehicle_time_and_the_block_ends_with_the_last_one(
    vehicle: Vehicle, server: Server
) -> None:
    with steerable(server) as commands:
        with vehicle.fly_velocity(speed_max_mps=2.0) as stick:
            stick.send(1.0, up_mps=-0.5)
            stick.send(right_mps=0.5, yaw_rate_rps=-0.2, for_s=1.0)
            assert stick.newest is not None and stick.newest.limited_by == "the fence"
        assert stick.result() == RESULT
    assert server.asked[-1][2]["on_client_loss"] == "cancel" and server.asked[-1][2]["speed_max_mps"] == 2.0
    assert fields_of(commands[0]) == ("g", 1.0, 0.0, -0.5, 0.0, False)
    repeated = [command for command in commands if command.right_mps]
    assert {fields_of(command) for command in repeated} == {("g", 0.0, 0.5, 0.0, -0.2, False)}
    assert repeated[-1].t_ns - repeated[0].t_ns >= 1e9 and repeated[0].t_ns >= 1e9
    assert max(b.t_ns - a.t_ns for a, b in zip(repeated, repeated[1:], strict=False)) <= 4e8  # noqa: RUF007
    assert commands[-1].is_last


def test_the_vehicle_stops_at_the_end_of_the_block_also_after_an_exception(vehicle: Vehicle, server: Server) -> None:
    with steerable(server) as commands:
        with pytest.raises(ZeroDivisionError), vehicle.fly_velocity() as stick:
            stick.send(1.0)
            raise ZeroDivisionError
        assert commands[-1].is_last
        with pytest.raises(Refused, match="succeeded already"):
            stick.send(1.0)


@pytest.mark.parametrize(("value", "words"), [(nan, "forward_mps"), (51.0, "forward_mps.*50"), ("fast", "forward_mps")])
def test_a_number_that_is_none_is_refused_by_its_name_and_not_sent(
    vehicle: Vehicle, server: Server, value: float, words: str
) -> None:
    with steerable(server) as commands, vehicle.fly_velocity() as stick:
        with pytest.raises(ValueError, match=words):
            stick.send(value)
        assert commands == []


def test_a_goal_that_has_ended_raises_its_reason_instead_of_sending(vehicle: Vehicle, server: Server) -> None:
    aborted = a_result("aborted", "hover was requested")
    server.serve("@action/fly_velocity", ACCEPTED, velocity_feedback(2_000_000_000), aborted)
    with pytest.raises(Aborted, match="hover was requested"), vehicle.fly_velocity() as stick:
        for _ in range(1000):
            stick.send(1.0, for_s=0.1)


def test_commands_go_on_after_vehicle_time_has_stood_still(vehicle: Vehicle, server: Server) -> None:
    with steerable(server, stall_s=3.0) as commands, vehicle.fly_velocity() as stick:
        stick.send(1.0)
        with pytest.raises(TimedOut):
            stick.send(1.0, for_s=60.0)
        assert stick.next_feedback(10.0) is not None
        stick.send(0.5, for_s=0.5)
        assert commands[-1].forward_mps == 0.5 and commands[-1].t_ns > commands[0].t_ns


def test_a_goal_sent_by_name_can_be_steered_too(vehicle: Vehicle, server: Server) -> None:
    with steerable(server):
        goal = vehicle.send("fly_velocity", on_client_loss="cancel")
        assert isinstance(goal, VelocityGoal)
        assert goal.finish() == RESULT


def test_the_client_for_asyncio_steers_alike(server: Server, endpoint: str) -> None:
    async def test(uav: aio.Vehicle) -> None:
        async with await uav.fly_velocity() as stick:
            await stick.send(1.0)
            await stick.send(right_mps=0.5, for_s=1.0)
            with pytest.raises(ValueError, match="up_mps"):
                await stick.send(up_mps=nan)
            assert stick.newest is not None and stick.newest.follows
        assert await stick.result() == RESULT
        again = await uav.send("fly_velocity", speed_max_mps=1.0)
        assert isinstance(again, aio.VelocityGoal)

    with steerable(server) as commands:
        with_vehicle(endpoint, server, test)
    assert fields_of(commands[0]) == ("g", 1.0, 0.0, 0.0, 0.0, False)
    assert [command for command in commands if command.right_mps][-1].t_ns >= commands[0].t_ns + 1e9
    assert commands[-1].is_last


def test_a_task_that_is_canceled_while_it_sends_cancels_the_goal(server: Server, endpoint: str) -> None:
    cancel = "@action/fly_velocity/cancel"

    async def test(uav: aio.Vehicle) -> None:
        stick = await uav.fly_velocity()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await stick.send(1.0, for_s=4.0)

    with steerable(server):
        server.serve(cancel, CancelReply(canceled=True))
        with_vehicle(endpoint, server, test)
    assert cancel in [name for name, *_ in server.asked]
