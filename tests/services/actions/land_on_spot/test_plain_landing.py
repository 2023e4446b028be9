"""A landing on a spot by the vehicle's own position: its climbs before the approach and after a slide, and a tilt over
what it touches."""

from math import hypot

import pytest

from jezero.base.frames import Quat, Vec3, quat_from_euler
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig, PlainLandingConfig
from jezero.services.actions.land_on_spot.plain_landing import (
    SPEED_HORIZONTAL_MAX_MPS,
    PlainLanding,
    TiltContactDetector,
)
from jezero.services.actions.motion.behaviour import Move, VehicleState

S = 1_000_000_000
DT_NS = 20_000_000
STILL: Vec3 = (0.0, 0.0, 0.0)
SETTINGS = LandOnSpotConfig(plain=PlainLandingConfig(approach_height_min_m=1.5))
CONFIG = ActionsConfig(land_on_spot=SETTINGS)


def at(pos_ned_m: Vec3, height_m: float | None, vel_ned_mps: Vec3 = STILL) -> VehicleState:
    return VehicleState(pos_ned_m, vel_ned_mps, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, height_m=height_m)


def landing(spot_ned_m: Vec3, state: VehicleState) -> PlainLanding:
    return PlainLanding(spot_ned_m, CONFIG, force=False, t_ns=0, state=state)


@pytest.mark.parametrize(
    ("z_ned_m", "height_m", "z_approach_ned_m"),
    [
        (-5.0, 0.5, -6.0),  # over raised ground, which the altitude knows nothing of
        (-5.0, 1.5, -5.0),
        (-0.5, 3.0, -0.5),  # over a hole
        (-0.5, None, -1.5),
        (-2.0, None, -2.0),
    ],
)
def test_it_approaches_at_least_a_metre_and_a_half_above_what_the_altimeter_measures(
    z_ned_m: float, height_m: float | None, z_approach_ned_m: float
) -> None:
    state = at((0.0, 0.0, z_ned_m), height_m)
    behaviour = landing((0.0, 10.0, 0.0), state)
    assert behaviour.path(state)[1] == pytest.approx((0.0, 10.0, z_approach_ned_m))
    move = behaviour.step(S, state)
    assert isinstance(move, Move)
    assert move.pos_ned_m is not None
    climbs = z_approach_ned_m < z_ned_m
    assert (move.pos_ned_m[2] < z_ned_m) is climbs
    assert (move.pos_ned_m[1] == 0.0) is climbs, "it climbs first, and comes nearer then"


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0)])
def test_a_vehicle_that_slides_over_the_ground_climbs_and_comes_down_again(direction: tuple[float, float]) -> None:
    behaviour, t_ns = landing(STILL, at((0.0, 0.0, -2.0), 2.0)), 0
    north, east = direction
    moves: list[Move] = []

    def step(state: VehicleState) -> Move:
        nonlocal t_ns
        t_ns += DT_NS
        move = behaviour.step(t_ns, state)
        assert isinstance(move, Move)
        moves.append(move)
        return move

    while behaviour.approaches:
        step(at((0.0, 0.0, -2.0), 2.0))
    slid_m = 0.0
    while (move := step(at((north * slid_m, east * slid_m, -0.15), 0.05))).feedback.phase != "go_around":
        slid_m += 0.01  # 0.5 m/s
        assert slid_m < 1.0
    assert slid_m > 0.15
    assert move.vel_ned_mps == pytest.approx((0.0, 0.0, -1.5)), "upwards"
    assert step(at((north * slid_m, east * slid_m, -1.4), 1.4)).vel_ned_mps == pytest.approx((0.0, 0.0, -1.5))
    step(at((north * slid_m, east * slid_m, -1.6), 1.6))
    again = step(at((north * slid_m, east * slid_m, -1.6), 1.6)).vel_ned_mps
    assert again is not None and again[2] > 0.0


def tilted(angle_rad: float, *, sideways: bool) -> Quat:
    return quat_from_euler(angle_rad, 0.0, 0.0) if sideways else quat_from_euler(0.0, angle_rad, 0.0)


@pytest.mark.parametrize("sideways", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("free_rad", "tilt_rad", "down_mps", "stalled_s", "tilts"),
    [
        (0.0, 0.19, 0.0, 0.3, True),
        (0.0, 0.16, 0.0, 0.3, False),
        (0.0, 0.19, 0.24, 0.3, True),
        (0.0, 0.19, 0.26, 0.3, False),
        (0.0, 0.19, 0.0, 0.1, False),
        (0.25, 0.25, 0.0, 0.3, False),
        (-0.1, 0.19, 0.0, 0.3, True),
    ],
    ids=["an edge", "level ground", "slow", "a gust while it descends", "for a moment", "the wind", "against the wind"],
)
def test_a_tilt_counts_as_contact_above_ten_degrees_more_than_in_the_air_in_a_descent_that_has_stopped(
    free_rad: float, tilt_rad: float, down_mps: float, stalled_s: float, tilts: bool, sign: float, sideways: bool
) -> None:
    """0.17 rad are permitted, half of the commanded 0.5 m/s, and 0.2 s."""
    detector, t_ns, found = TiltContactDetector(), 0, []
    for q, vel_down_mps, duration_s in (
        (tilted(sign * free_rad, sideways=sideways), 0.5, 4.0),
        (tilted(sign * tilt_rad, sideways=sideways), down_mps, stalled_s),
    ):
        for _ in range(round(duration_s * S / DT_NS)):
            t_ns += DT_NS
            state = VehicleState((0.0, 0.0, -1.0), (0.0, 0.0, vel_down_mps), q, armed=True, landed=False)
            found.append(detector.update(t_ns, state, 0.5))
    assert found[-1] is tilts
    assert not any(found[:200]), "in the air"


def test_a_short_tilt_in_the_air_is_no_wind_yet() -> None:
    """0.2 s of 0.2 rad pass a filter of 0.5 s with a third."""
    detector, level = TiltContactDetector(), (1.0, 0.0, 0.0, 0.0)
    for t_ns in range(DT_NS, 4 * S + 10 * DT_NS, DT_NS):
        q = tilted(0.2, sideways=False) if t_ns > 4 * S else level
        detector.update(t_ns, VehicleState(STILL, (0.0, 0.0, 0.5), q, armed=True, landed=False), 0.5)
    assert 0.03 < hypot(*detector.free_down_ned) < 0.09


def descending() -> PlainLanding:
    """A landing that has begun to descend from 5 m over the origin."""
    behaviour, t_ns = landing(STILL, at((0.0, 0.0, -5.0), 5.0)), 0
    while behaviour.approaches:
        t_ns += DT_NS
        behaviour.step(t_ns, at((0.0, 0.0, -5.0), 5.0))
    return behaviour


@pytest.mark.parametrize(("height_m", "way_m"), [(5.0, 5.0), (0.2, 0.2), (-0.1, 0.0)])
def test_what_remains_of_a_descent_is_the_way_down(height_m: float, way_m: float) -> None:
    remaining = descending().remaining(at((0.0, 0.0, -5.0), height_m))
    assert remaining.distance_m == way_m
    assert remaining.time_s > way_m / SETTINGS.plain.speed_high_mps


@pytest.mark.parametrize("off_m", [0.1, -0.2, 30.0])
def test_a_descent_comes_back_to_its_spot_without_overshoot_and_not_faster_than_it_may(off_m: float) -> None:
    behaviour = descending()
    move = behaviour.step(20 * S, at((off_m, 0.0, -4.0), 4.0))
    assert isinstance(move, Move) and move.vel_ned_mps is not None
    back_mps = -move.vel_ned_mps[0] if off_m > 0.0 else move.vel_ned_mps[0]
    assert 0.0 < back_mps <= min(abs(off_m) / 1.0, SPEED_HORIZONTAL_MAX_MPS) + 1e-9
