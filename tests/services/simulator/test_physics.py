"""Forces, contact and rays, against numbers worked out by hand."""

import subprocess
import sys
from collections.abc import Iterator
from math import atan2, cos, degrees, isfinite, pi, radians, sin, sqrt

import msgspec
import numpy as np
import pytest

from jezero.base.frames import Vec3, norm, quat_from_euler, subtract, tilt_from_quat
from jezero.base.vehicle_config import PlanetConfig, VehicleConfig
from jezero.services.simulator.body import BodyState
from jezero.services.simulator.config import RoverConfig, SimulatorConfig, TerrainConfig, UavConfig
from jezero.services.simulator.rover import RoverModel
from jezero.services.simulator.schedule import DT_S
from jezero.services.simulator.terrain import make_terrain
from jezero.services.simulator.uav import Uav, ground_effect
from jezero.services.simulator.world import World

CONFIG = SimulatorConfig()
VEHICLE = VehicleConfig()
PLATFORM_M = VEHICLE.platform.height_m
TERRAIN = make_terrain(CONFIG.terrain)
WEIGHT_N = 1.5 * 9.81
ZERO: Vec3 = (0.0, 0.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)
HIGH_M = 1000.0
AT_REST = BodyState(ZERO, ZERO, (1.0, 0.0, 0.0, 0.0), ZERO, (0.0, 0.0, -9.81))


@pytest.fixture(scope="module")
def rover() -> RoverModel:
    return RoverModel(CONFIG.rover, TERRAIN, PLATFORM_M)


@pytest.fixture(scope="module")
def shared_world(rover: RoverModel) -> Iterator[World]:
    world = World(CONFIG, VEHICLE, TERRAIN, rover.state)
    yield world
    world.close()


@pytest.fixture
def world(shared_world: World) -> World:
    shared_world.respawn()
    return shared_world


def spun_up(uav: Uav, commands: tuple[float, ...], body: BodyState = AT_REST, wind: Vec3 = ZERO) -> tuple[Vec3, Vec3]:
    for _ in range(500):
        wrench = uav.step(commands, body, wind, HIGH_M)
    return wrench


# -- motors and air --


def test_half_command_carries_the_weight() -> None:
    force_ned_n, torque_frd_nm = spun_up(Uav(CONFIG, VEHICLE, DT_S), (0.5, 0.5, 0.5, 0.5))
    assert force_ned_n == pytest.approx((0.0, 0.0, -WEIGHT_N), rel=1e-4)
    # airframe 10016: sum of forward arms is zero, of sideways arms too, the yaw moments cancel
    assert torque_frd_nm == pytest.approx(ZERO, abs=1e-9)


def test_each_motor_turns_the_body_as_airframe_10016_says() -> None:
    """Full thrust of one motor is 2 * weight / 4; motor 1 is front right and counter-clockwise."""
    one_n = 0.5 * WEIGHT_N
    _, torque_frd_nm = spun_up(Uav(CONFIG, VEHICLE, DT_S), (1.0, 0.0, 0.0, 0.0))
    assert torque_frd_nm == pytest.approx((-0.245 * one_n, 0.1515 * one_n, 0.05 * one_n), rel=1e-3)
    _, torque_frd_nm = spun_up(Uav(CONFIG, VEHICLE, DT_S), (0.0, 0.0, 0.0, 1.0))
    assert torque_frd_nm == pytest.approx((-0.1875 * one_n, -0.1515 * one_n, -0.05 * one_n), rel=1e-3)


def test_a_rotor_reaches_63_percent_of_its_speed_in_one_time_constant() -> None:
    uav = Uav(CONFIG, VEHICLE, DT_S)
    for _ in range(round(CONFIG.uav.tau_motor_s / DT_S)):
        uav.step((1.0, 1.0, 1.0, 1.0), AT_REST, ZERO, HIGH_M)
    assert uav.speeds[0] == pytest.approx(0.632, abs=0.001)


def test_three_metres_per_second_of_wind_tilt_the_hovering_vehicle_by_six_and_a_half_degrees() -> None:
    force_ned_n, _ = spun_up(Uav(CONFIG, VEHICLE, DT_S), (0.5, 0.5, 0.5, 0.5), wind=(0.0, 3.0, 0.0))
    assert force_ned_n[0] == pytest.approx(0.0, abs=1e-9)
    assert degrees(atan2(force_ned_n[1], WEIGHT_N)) == pytest.approx(6.5, abs=0.4)


def test_body_drag_grows_with_the_square_of_the_airspeed() -> None:
    """Rotors at rest: 0.5 * 1.2 kg/m^3 * 0.06 m^2 * (10 m/s)^2 = 3.6 N sideways, 0.1 m^2 give 6.0 N when falling."""
    resting = Uav(CONFIG, VEHICLE, DT_S)
    body = AT_REST._replace(vel_ned_mps=(10.0, 0.0, 0.0))
    assert resting.step((0.0,) * 4, body, ZERO, HIGH_M)[0] == pytest.approx((-3.6, 0.0, 0.0))
    body = AT_REST._replace(vel_ned_mps=(0.0, 0.0, 10.0))
    assert resting.step((0.0,) * 4, body, ZERO, HIGH_M)[0] == pytest.approx((0.0, 0.0, -6.0))


def test_thrust_follows_the_body() -> None:
    body = AT_REST._replace(q_ned_from_frd=quat_from_euler(radians(90.0), 0.0, 0.0))
    force_ned_n, _ = spun_up(Uav(CONFIG, VEHICLE, DT_S), (0.5, 0.5, 0.5, 0.5), body)
    assert force_ned_n == pytest.approx((0.0, WEIGHT_N, 0.0), rel=1e-4, abs=1e-3)


def test_ground_effect_follows_cheeseman_and_bennett() -> None:
    assert ground_effect(0.128, 0.128) == pytest.approx(16.0 / 15.0)
    assert ground_effect(10.0, 0.128) == pytest.approx(1.0, abs=1e-4)
    assert ground_effect(0.0, 0.128) <= 1.3


# -- rigid body --


def test_free_fall(world: World) -> None:
    """One second at 9.81 m/s^2; the engine's steps add half a step's fall. No force is felt."""
    world.place_uav((0.0, 0.0, -50.0), 0.0)
    for _ in range(250):
        state = world.step(ZERO, ZERO)
    assert state.vel_ned_mps == pytest.approx((0.0, 0.0, 9.81), rel=1e-9)
    assert state.pos_ned_m[2] == pytest.approx(-50.0 + 0.5 * 9.81 * (1.0 + DT_S), rel=1e-6)
    assert state.acc_frd_mps2 == pytest.approx(ZERO, abs=1e-9)


def test_hover_thrust_balances_the_weight(world: World) -> None:
    world.place_uav((0.0, 0.0, -5.0), 0.3)
    uav = Uav(CONFIG, VEHICLE, DT_S)
    spun_up(uav, (0.5, 0.5, 0.5, 0.5))
    for _ in range(500):
        state = world.step(*uav.step((0.5, 0.5, 0.5, 0.5), world.state, ZERO, HIGH_M))
    assert state.pos_ned_m == pytest.approx((0.0, 0.0, -5.0), abs=0.001)
    assert state.acc_frd_mps2 == pytest.approx((0.0, 0.0, -9.81), abs=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_torque_turns_about_its_own_axis_in_the_body(world: World, axis: int) -> None:
    """Torque = inertia * 2 rad/s^2 for 0.2 s gives 0.4 rad/s about the same body axis, with heading 1 rad."""
    world.place_uav((0.0, 0.0, -5.0), 1.0)
    torque = [0.0, 0.0, 0.0]
    torque[axis] = 2.0 * VEHICLE.airframe.inertia_frd_kgm2[axis]
    for _ in range(50):
        state = world.step((0.0, 0.0, -WEIGHT_N), (torque[0], torque[1], torque[2]))
    expected = [0.0, 0.0, 0.0]
    expected[axis] = 0.4
    assert state.rates_frd_rps == pytest.approx(expected, abs=1e-6)


def test_a_northward_force_accelerates_northwards(world: World) -> None:
    world.place_uav((0.0, 0.0, -5.0), radians(90.0))
    state = world.step((1.5, 0.0, -WEIGHT_N), ZERO)
    assert state.vel_ned_mps == pytest.approx((0.004, 0.0, 0.0), abs=1e-9)
    # heading east, north is to the left
    assert state.acc_frd_mps2 == pytest.approx((0.0, -1.0, -9.81), abs=1e-6)


# -- contact --


def test_at_rest_the_vehicle_feels_minus_g_and_stays(world: World) -> None:
    start = world.state
    for _ in range(2500):
        state = world.step(ZERO, ZERO)
        assert state.acc_frd_mps2 == pytest.approx((0.0, 0.0, -9.81), abs=1e-3)
    assert norm(subtract(state.pos_ned_m, start.pos_ned_m)) < 1e-4
    assert world.contact_force_n() == pytest.approx(WEIGHT_N, rel=1e-3)
    assert world.height_stand_m == pytest.approx(0.148, abs=0.005)


def test_wind_does_not_blow_the_standing_vehicle_away(world: World) -> None:
    start = world.state
    for _ in range(1000):
        state = world.step((0.0, 5.0, 0.0), ZERO)
    assert norm(subtract(state.pos_ned_m, start.pos_ned_m)) < 0.002


@pytest.mark.parametrize("place", ["ground", "slope", "platform", "beyond the grid"])
def test_dropped_from_half_a_metre_it_bounces_and_rests_upright(world: World, rover: RoverModel, place: str) -> None:
    below = {
        "ground": (0.0, 0.0, 0.0),
        "slope": (30.0, -20.0, -TERRAIN.height_m(30.0, -20.0)),
        "platform": rover.state.pos_ned_m,
        "beyond the grid": (100.0, 10.0, 0.0),
    }[place]
    world.place_uav((below[0], below[1], below[2] - 0.5 - VEHICLE.airframe.height_stand_m - CONFIG.uav.sag_legs_m), 0.4)
    states = [world.step(ZERO, ZERO) for _ in range(1000)]
    upwards_mps = max(-state.vel_ned_mps[2] for state in states)
    peak_mps2 = max(norm(state.acc_frd_mps2) for state in states)
    last = states[-1]
    assert 0.3 < upwards_mps < 2.5
    assert 50.0 < peak_mps2 < 400.0
    assert norm(last.vel_ned_mps) < 1e-3
    assert norm(last.rates_frd_rps) < 1e-3
    assert degrees(tilt_from_quat(last.q_ned_from_frd)) < 5.0
    assert last.pos_ned_m[2] == pytest.approx(below[2] - world.height_stand_m, abs=0.02)


def test_a_gentle_touchdown_does_not_saturate_the_accelerometer(world: World) -> None:
    world.place_uav((0.0, 0.0, -0.16), 0.0, (0.2, 0.0, 0.5))
    peak_mps2 = max(norm(world.step(ZERO, ZERO).acc_frd_mps2) for _ in range(250))
    assert 15.0 < peak_mps2 < 100.0


@pytest.mark.parametrize("height_m", [10.0, 100.0])
def test_a_crash_ends_on_the_ground(world: World, height_m: float) -> None:
    world.place_uav((20.0, 10.0, -height_m), 0.0)
    for _ in range(3000):
        state = world.step(ZERO, ZERO)
    assert -1.0 < state.pos_ned_m[2] < 1.0


def test_respawn_puts_it_back_at_rest(world: World) -> None:
    first = world.state
    world.place_uav((3.0, 4.0, -5.0), 1.0, (1.0, 1.0, 1.0))
    for _ in range(10):
        world.step(ZERO, (0.1, 0.1, 0.1))
    world.respawn()
    assert world.state == first
    assert world.step(ZERO, ZERO).acc_frd_mps2 == pytest.approx((0.0, 0.0, -9.81), abs=0.05)


def test_on_the_platform_it_starts_on_the_platform() -> None:
    config = SimulatorConfig(uav=UavConfig(start="platform"), rover=RoverConfig(start_north_m=20.0, start_east_m=9.0))
    rover = RoverModel(config.rover, TERRAIN, PLATFORM_M)
    world = World(config, VEHICLE, TERRAIN, rover.state)
    assert world.start_ned_m == pytest.approx((20.0, 9.0, rover.state.pos_ned_m[2] - 0.148), abs=0.003)
    world.close()


# -- rover and rays --


def test_the_platform_is_half_a_metre_above_the_ground(rover: RoverModel) -> None:
    north_m, east_m, down_m = rover.state.pos_ned_m
    assert -down_m == pytest.approx(TERRAIN.height_m(north_m, east_m) + 0.5)


def test_the_rover_drives_in_a_circle() -> None:
    """1 m/s and 0.2 rad/s: after half a turn it is a diameter, 10 m, to the right of where it started."""
    flat = make_terrain(TerrainConfig(std_ground_m=0.0, craters=0, rocks=0))
    rover = RoverModel(RoverConfig(start_north_m=0.0, start_east_m=0.0, start_yaw_rad=0.0), flat, PLATFORM_M)
    for _ in range(3927):
        state = rover.drive(1.0, 0.2, DT_S)
    assert state.pos_ned_m == pytest.approx((0.0, 10.0, -0.5), abs=0.01)
    assert state.vel_ned_mps == pytest.approx((-1.0, 0.0, 0.0), abs=0.01)


def test_a_driving_rover_carries_the_vehicle_along() -> None:
    flat = make_terrain(TerrainConfig(std_ground_m=0.0, craters=0, rocks=0))
    config = SimulatorConfig(uav=UavConfig(start="platform"))
    rover = RoverModel(config.rover, flat, PLATFORM_M)
    world = World(config, VEHICLE, flat, rover.state)
    offset_m = subtract(world.state.pos_ned_m, rover.state.pos_ned_m)
    for step in range(500):
        world.move_rover(rover.drive(min(0.5, 0.002 * step), 0.0, DT_S))
        world.step(ZERO, ZERO)
    assert subtract(world.state.pos_ned_m, rover.state.pos_ned_m) == pytest.approx(offset_m, abs=0.02)
    world.close()


def test_the_beam_sees_ground_platform_and_nothing(world: World, rover: RoverModel) -> None:
    lens: Vec3 = (0.0, 0.0, 0.05)
    world.place_uav((12.0, -7.0, -6.0), 0.0)
    assert world.range_m(lens, DOWN, 10.0) == pytest.approx(5.95 - TERRAIN.height_m(12.0, -7.0), abs=0.003)
    north_m, east_m, down_m = rover.state.pos_ned_m
    world.place_uav((north_m, east_m, down_m - 3.0), 0.0)
    assert world.range_m(lens, DOWN, 10.0) == pytest.approx(2.95, abs=1e-6)
    world.place_uav((12.0, -7.0, -11.0), 0.0)
    assert world.range_m(lens, DOWN, 10.0) is None


def test_a_tilted_beam_is_longer(world: World) -> None:
    """Rolled by 60 degrees, 4 m up over level ground: 8 m, less the lens' mount."""
    world.place_uav((100.0, 0.0, -4.0), 0.0)
    world.state = world.state._replace(q_ned_from_frd=quat_from_euler(radians(60.0), 0.0, 0.0))
    assert world.range_m((0.0, 0.0, 0.05), DOWN, 10.0) == pytest.approx(7.95, abs=1e-6)


def test_a_beam_points_in_any_direction_of_the_body(world: World, rover: RoverModel) -> None:
    """The platform is 1 m wide: 3 m beside its middle, its edge is 2.5 m away, less 0.4 m of the lens' mount.

    The vehicle looks along the rover's side, so that the beam meets the edge at a right angle.
    """
    north_m, east_m, down_m = rover.state.pos_ned_m
    yaw_rad = rover.state.yaw_rad
    beside: Vec3 = (north_m - 3.0 * cos(yaw_rad), east_m - 3.0 * sin(yaw_rad), down_m + 0.03)
    world.place_uav(beside, yaw_rad)
    lens: Vec3 = (0.4, 0.0, 0.0)
    assert world.range_m(lens, (1.0, 0.0, 0.0), 10.0) == pytest.approx(2.1, abs=1e-3)
    assert world.range_m(lens, (1.0, 0.0, 0.0), 2.0) is None
    world.place_uav(beside, yaw_rad - radians(90.0))
    assert world.range_m((0.0, 0.4, 0.0), (0.0, 1.0, 0.0), 10.0) == pytest.approx(2.1, abs=1e-3)
    world.place_uav((100.0, 0.0, -4.0), 0.0)
    slant: Vec3 = (sqrt(0.75), 0.0, 0.5)
    assert world.range_m(lens, slant, 10.0) == pytest.approx(8.0, abs=1e-3)
    assert world.range_m((0.0, 0.0, -0.1), (0.0, 0.0, -1.0), 100.0) is None


def test_rocks_stop_the_vehicle(world: World) -> None:
    corners = TERRAIN.rock_vertices_ned_m[:12]
    north_m, east_m, _ = corners.mean(axis=0).tolist()
    ground_m = TERRAIN.height_m(north_m, east_m)
    world.place_uav((north_m, east_m, -5.0), 0.0)
    range_m = world.range_m(ZERO, DOWN, 10.0)
    assert range_m is not None
    assert range_m < 5.0 - ground_m - 0.05


def test_on_mars_everything_falls_slower() -> None:
    vehicle = msgspec.structs.replace(VEHICLE, planet=PlanetConfig(gravity_mps2=3.71))
    world = World(CONFIG, vehicle, TERRAIN, RoverModel(CONFIG.rover, TERRAIN, PLATFORM_M).state)
    assert world.step(ZERO, ZERO).acc_frd_mps2 == pytest.approx((0.0, 0.0, -3.71), abs=1e-3)
    world.place_uav((0.0, 0.0, -20.0), 0.0)
    for _ in range(250):
        state = world.step(ZERO, ZERO)
    assert state.vel_ned_mps[2] == pytest.approx(3.71)
    world.close()


@pytest.mark.parametrize("seed", range(4))
def test_no_motor_commands_make_the_state_non_finite(world: World, seed: int) -> None:
    """Each motor is anywhere between off and full for half a second at a time: it tumbles, crashes and scrapes."""
    rng = np.random.default_rng(seed)
    uav = Uav(CONFIG, VEHICLE, DT_S)
    for step in range(5000):
        if step % 125 == 0:
            commands = tuple(rng.random(4).round().tolist())
        height_m = 0.1 - world.state.pos_ned_m[2]
        state = world.step(*uav.step(commands, world.state, (3.0, 0.0, 0.0), height_m))
        assert all(isfinite(value) for part in state for value in part)
    assert norm(state.rates_frd_rps) < 300.0
    assert state.pos_ned_m[2] < 2.0


def test_the_physics_engine_prints_nothing_when_it_is_imported() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import jezero.services.simulator.world"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("", "")


def test_the_rover_has_wheels_with_gaps_between_them() -> None:
    """A beam 10 cm above level ground from beside the rover meets its middle wheel, and nothing 24 cm before it."""
    flat = make_terrain(TerrainConfig(std_ground_m=0.0, craters=0, rocks=0))
    config = RoverConfig(start_north_m=10.0, start_east_m=0.0, start_yaw_rad=0.0)
    world = World(CONFIG, VEHICLE, flat, RoverModel(config, flat, PLATFORM_M).state)
    ranges_m = []
    for forward_m in (0.0, 0.24):
        world.place_uav((10.0 + forward_m, -4.0, -1.0), 0.5 * pi)
        ranges_m.append(world.range_m((1.0, 0.0, 0.9), (1.0, 0.0, 0.0), 10.0))
    world.close()
    assert ranges_m == [pytest.approx(4.0 - 1.0 - 0.55, abs=0.02), None]
