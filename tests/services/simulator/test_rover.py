"""The rover: its wheels follow commands, its platform is level, tilted, or leans with the ground below it."""

from math import cos, degrees, radians, sin

import pytest

from jezero.base.frames import Vec3, euler_from_quat, quat_rotate, tilt_from_quat
from jezero.schemas.commands import RoverCommand
from jezero.services.simulator.config import RoverConfig, TerrainConfig
from jezero.services.simulator.rover import Drive, RoverModel
from jezero.services.simulator.terrain import Terrain, make_terrain

HILLSIDE = make_terrain(TerrainConfig(slope_deg=10.0, slope_towards_deg=0.0, std_ground_m=0.0, craters=0, rocks=0))
"""It descends to the north."""


def rover(terrain: Terrain = HILLSIDE, **settings: object) -> RoverModel:
    at_origin = {"start_north_m": 0.0, "start_east_m": 0.0, "start_yaw_rad": 0.0, **settings}
    return RoverModel(RoverConfig(**at_origin), terrain, 0.5)  # type: ignore[arg-type]


def test_a_rover_stays_upright_unless_it_leans_with_the_ground() -> None:
    assert tilt_from_quat(rover().state.q_ned_from_rover_body) == 0.0


@pytest.mark.parametrize(
    ("yaw_deg", "roll_deg", "pitch_deg"),
    [(0.0, 0.0, -10.0), (180.0, 0.0, 10.0), (90.0, -10.0, 0.0), (-90.0, 10.0, 0.0)],
)
def test_a_leaning_rover_has_the_slope_of_the_ground(yaw_deg: float, roll_deg: float, pitch_deg: float) -> None:
    leaning = rover(tilts_with_ground=True, start_yaw_rad=radians(yaw_deg))
    roll_rad, pitch_rad, _ = euler_from_quat(leaning.state.q_ned_from_rover_body)
    assert (degrees(roll_rad), degrees(pitch_rad)) == pytest.approx((roll_deg, pitch_deg), abs=0.1)


def test_the_low_side_of_a_tilted_platform_is_where_the_settings_say() -> None:
    tilted = rover(tilt_deg=10.0, tilt_towards_deg=30.0, start_yaw_rad=0.7)
    low_side: Vec3 = (cos(radians(30.0)), sin(radians(30.0)), 0.0)
    down = quat_rotate(tilted.state.q_ned_from_rover_body, low_side)[2]
    assert down == pytest.approx(sin(radians(10.0)))


def test_a_rover_that_drives_over_an_edge_of_the_slope_turns_as_fast_as_its_attitude_changes() -> None:
    hill = make_terrain(TerrainConfig(seed=3))
    driven = rover(hill, tilts_with_ground=True, start_north_m=10.0)
    before = euler_from_quat(driven.state.q_ned_from_rover_body)[1]
    turned_rad = 0.0
    for _ in range(500):
        turned_rad += driven.drive(1.0, 0.0, 0.004).rates_ned_rps[1] * 0.004
    after = euler_from_quat(driven.state.q_ned_from_rover_body)[1]
    assert turned_rad == pytest.approx(after - before, abs=2e-3)


# -- wheels ----------------------------------------------------------------------------------------------

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
