"""The rover's platform: level, tilted on the rover, or leaning with the ground below it."""

from math import cos, degrees, radians, sin

import pytest

from jezero.base.frames import Vec3, euler_from_quat, quat_rotate, tilt_from_quat
from jezero.services.simulator.config import RoverConfig, TerrainConfig
from jezero.services.simulator.rover import RoverModel
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
