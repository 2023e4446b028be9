"""The rover: its wheels follow commands, its platform is level, tilted, or leans with the ground below it."""

from itertools import pairwise
from math import cos, degrees, hypot, radians, sin

import numpy as np
import pytest

from jezero.base.frames import Vec3, euler_from_quat, quat_rotate, scale, subtract, tilt_from_quat
from jezero.schemas.commands import RoverCommand
from jezero.services.simulator.config import RoverConfig, SeaConfig, TerrainConfig
from jezero.services.simulator.rover import Drive, RoverModel
from jezero.services.simulator.sea import make_sea
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


def test_a_wheel_stands_on_the_highest_of_ground_and_rocks() -> None:
    rocky = make_terrain(TerrainConfig(std_ground_m=0.0, craters=0, rocks=1))
    middle_ned_m = rocky.rock_vertices_ned_m.mean(axis=0)
    radius_m = float(np.linalg.norm(rocky.rock_vertices_ned_m - middle_ned_m, axis=1).mean())
    north_m, east_m, down_m = middle_ned_m
    assert rocky.height_of_wheel_m(north_m, east_m, 0.1) == pytest.approx(radius_m - down_m)
    beside_m = radius_m + 0.05
    lower_m = rocky.height_of_wheel_m(north_m + beside_m, east_m, 0.1)
    assert lower_m == pytest.approx(max(0.0, ((radius_m + 0.1) ** 2 - beside_m**2) ** 0.5 - 0.1 - down_m))
    assert rocky.height_of_wheel_m(north_m + radius_m + 0.2, east_m, 0.1) == rocky.height_m(north_m, east_m)


def test_a_rover_that_drives_over_rocks_heaves_and_leans_and_is_level_behind_them() -> None:
    rocky = make_terrain(TerrainConfig(std_ground_m=0.0, craters=0, rocks=1, radius_rock_min_m=0.2))
    north_m, east_m, _ = rocky.rock_vertices_ned_m.mean(axis=0).tolist()
    driven = rover(rocky, tilts_with_ground=True, start_north_m=north_m - 2.0, start_east_m=east_m - 0.49)
    tilts_rad, heights_m, climbs_mps = [], [], []
    for _ in range(1000):
        state = driven.drive(1.0, 0.0, 0.004)
        tilts_rad.append(tilt_from_quat(state.q_ned_from_rover_body))
        heights_m.append(-state.pos_ned_m[2])
        climbs_mps.append(-state.vel_ned_mps[2])
    assert degrees(max(tilts_rad)) > 5.0 and max(heights_m) > 0.53
    assert tilts_rad[-1] == 0.0 and heights_m[-1] == pytest.approx(0.5)
    assert sum(climbs_mps) * 0.004 == pytest.approx(0.0, abs=1e-9)


def test_a_rover_on_waves_heaves_and_rolls_though_nobody_drives_it() -> None:
    config = RoverConfig(start_north_m=0.0, start_east_m=0.0, sea=SeaConfig(wave_height_m=0.5))
    afloat = RoverModel(config, HILLSIDE, 0.5, make_sea(config.sea, 1, 9.81))
    assert afloat.moves_by_itself and not rover().moves_by_itself
    states = [afloat.drive(0.0, 0.0, 0.004) for _ in range(5000)]
    heights_m = [-state.pos_ned_m[2] for state in states]
    assert max(heights_m) - min(heights_m) > 0.2
    sideways_m = max(hypot(*state.pos_ned_m[:2]) for state in states)
    assert 0.01 < sideways_m < 0.1  # the platform is half a metre above the point that it turns about
    for one, other in pairwise(states[:100]):
        moved_mps = scale(subtract(other.pos_ned_m, one.pos_ned_m), 250.0)
        assert other.vel_ned_mps == pytest.approx(moved_mps)


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
