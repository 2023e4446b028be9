"""The rover's wheels: what they do of what they are told."""

import pytest

from jezero.schemas.commands import RoverCommand
from jezero.services.simulator.config import RoverConfig
from jezero.services.simulator.drive import Drive

STEP_NS = 4_000_000
S = 1_000_000_000


def command(t_ns: int, speed_mps: float = 1.0, yaw_rate_rps: float = 0.2) -> RoverCommand:
    return RoverCommand(t_ns=t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=yaw_rate_rps)


def run(drive: Drive, from_ns: int, seconds: float) -> int:
    t_ns = from_ns
    while t_ns < from_ns + round(seconds * S):
        drive.step(t_ns, 0.004)
        t_ns += STEP_NS
    return t_ns


def test_it_comes_to_speed_with_bounded_acceleration_and_stops_half_a_second_after_the_last_command() -> None:
    drive = Drive(RoverConfig(acc_max_mps2=0.5, acc_yaw_max_rps2=0.5))
    assert not drive.moves
    drive.update(S, [command(S)])
    t_ns = run(drive, S, 0.4)
    assert drive.speed_mps == pytest.approx(0.2, abs=0.003)
    assert drive.yaw_rate_rps == 0.2
    t_ns = run(drive, t_ns, 0.1)
    assert drive.speed_mps == pytest.approx(0.25, abs=0.003)
    run(drive, t_ns, 1.0)
    assert not drive.moves


@pytest.mark.parametrize("age_s", [0.31, -0.06, 3.0])
def test_commands_that_are_old_or_from_the_future_are_not_obeyed(age_s: float) -> None:
    drive = Drive(RoverConfig())
    drive.update(10 * S, [command(10 * S - round(age_s * S))])
    run(drive, 10 * S, 0.1)
    assert not drive.moves


def test_a_command_that_was_overtaken_changes_nothing() -> None:
    drive = Drive(RoverConfig())
    drive.update(S, [command(S, 1.0), command(S - 1, -1.0)])
    run(drive, S, 0.1)
    assert drive.speed_mps > 0.0
