"""Targets in front of a fence, against numbers worked out by hand: 1 m/s² of braking, 0.4 m from the edge."""

from math import hypot, sqrt
from random import Random

import pytest

from jezero.base.fence import nearest
from jezero.base.frames import Vec3, add, scale, subtract
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.schemas.fence import Fence, Zone
from jezero.services.vehicle_bridge.motion_limits import inward_target, limited_target
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

FIELD = Zone(name="field", corners_ned_m=((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)))
CRATER = Zone(name="crater", corners_ned_m=((4.0, -2.0), (8.0, -2.0), (8.0, 2.0), (4.0, 2.0)))
FENCE = Fence(keep_in=FIELD, keep_out=(CRATER,), ceiling_m=10.0, floor_over_ground_m=1.0)
LIMITS = VehicleLimitsConfig(speed_max_mps=100.0)
"""No limit that these targets meet: the fence alone holds them."""


def at(pos_ned_m: Vec3, vel_ned_mps: Vec3 = (0.0, 0.0, 0.0), height_m: float | None = None) -> VehicleSnapshot:
    return VehicleSnapshot(
        t_ns=0, timer_ns=0, pos_ned_m=pos_ned_m, vel_ned_mps=vel_ned_mps, height_m=height_m or -pos_ned_m[2]
    )


def point(pos_ned_m: Vec3) -> Target:
    return Target(pos_ned_m, None, None, 0.0)


def speed(vel_ned_mps: Vec3) -> Target:
    return Target(None, vel_ned_mps, (1.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize(
    ("vehicle", "target"),
    [
        (at((0.0, 0.0, -3.0)), point((3.0, 0.0, -3.0))),
        (at((0.0, 3.0, -3.0)), point((15.0, 3.0, -3.0))),
        (at((0.0, 3.0, -3.0)), speed((5.0, 0.0, 0.0))),
        (at((0.0, 0.0, -9.0)), speed((0.0, 0.0, -0.5))),
        (at((25.0, 0.0, -3.0)), point((12.0, 0.0, -3.0))),
    ],
)
def test_a_target_that_stays_inside_or_leads_in_is_not_changed(vehicle: VehicleSnapshot, target: Target) -> None:
    limited, reason = limited_target(FENCE, LIMITS, target, vehicle, floor_holds=True)
    assert limited is target
    assert reason == ""


@pytest.mark.parametrize(
    ("vehicle", "target", "expected", "by"),
    [
        (at((2.5, 0.0, -3.0)), point((6.0, 0.0, -3.0)), (3.6, 0.0, -3.0), "crater"),
        (at((2.5, 0.0, -3.0)), point((12.0, 0.0, -3.0)), (3.6, 0.0, -3.0), "crater"),
        (at((18.0, 18.0, -3.0)), point((30.0, 30.0, -3.0)), (19.6, 19.6, -3.0), "field"),
        (at((0.0, 0.0, -9.0)), point((0.0, 0.0, -12.0)), (0.0, 0.0, -9.6), "ceiling"),
        (at((0.0, 0.0, -3.0), height_m=1.5), point((0.0, 0.0, -1.0)), (0.0, 0.0, -2.5), "floor"),
        (at((22.0, 0.0, -3.0)), point((23.0, 0.0, -3.0)), (22.0, 0.0, -3.0), "field"),
        (at((3.9, 0.0, -3.0)), point((5.0, 0.0, -3.0)), (3.6, 0.0, -3.0), "crater"),
    ],
)
def test_a_point_beyond_the_fence_becomes_one_in_front_of_it(
    vehicle: VehicleSnapshot, target: Target, expected: Vec3, by: str
) -> None:
    limited, reason = limited_target(FENCE, LIMITS, target, vehicle, floor_holds=True)
    assert limited.pos_ned_m == pytest.approx(expected)
    assert by in reason


def test_a_speed_towards_the_fence_is_one_from_which_the_vehicle_stops_in_front_of_it() -> None:
    limited, reason = limited_target(FENCE, LIMITS, speed((0.0, 9.0, 0.0)), at((0.0, 15.0, -3.0)), floor_holds=True)
    assert limited.vel_ned_mps == pytest.approx((0.0, sqrt(2.0 * 1.0 * 4.6), 0.0))
    assert limited.acc_ned_mps2 is None
    assert "'field'" in reason


@pytest.mark.parametrize(
    ("vehicle", "limited_to_mps"),
    [
        (at((0.0, 11.5, -3.0)), None),
        (at((0.0, 11.7, -3.0)), (0.0, 3.975, 0.0)),
        (at((-11.5, 0.0, -3.0)), None),
        (at((-11.7, 0.0, -3.0)), (-3.975, 0.0, 0.0)),
        (at((0.0, 0.0, -1.5)), None),
        (at((0.0, 0.0, -1.7)), (0.0, 0.0, -3.975)),
    ],
)
def test_four_metres_per_second_are_limited_from_where_the_vehicle_can_just_stop_on(
    vehicle: VehicleSnapshot, limited_to_mps: Vec3 | None
) -> None:
    """4 m/s need 8 m at 1 m/s², and 0.4 m are kept: 8.5 m are enough, and in 8.3 m stops what has √(2 · 7.9) m/s."""
    assert vehicle.pos_ned_m is not None
    north_m, east_m, _ = vehicle.pos_ned_m
    wanted = (0.0, 4.0, 0.0) if east_m else (-4.0, 0.0, 0.0) if north_m else (0.0, 0.0, -4.0)
    limited, reason = limited_target(FENCE, LIMITS, speed(wanted), vehicle, floor_holds=True)
    assert limited.vel_ned_mps == pytest.approx(limited_to_mps or wanted, abs=0.001)
    assert bool(reason) is (limited_to_mps is not None)


OUTSIDE, INSIDE = (10.0, 0.0, -3.0), (8.0, 0.0, -3.0)


@pytest.mark.parametrize(
    ("target", "inside_ned_m", "expected"),
    [
        (point((10.0, 0.0, -5.0)), INSIDE, point((9.0, 0.0, -5.0))),
        (point((12.0, 0.0, -3.0)), INSIDE, point((9.0, 0.0, -3.0))),
        (point((9.5, 0.0, -3.0)), INSIDE, point((9.0, 0.0, -3.0))),
        (point((10.0, 0.0, -3.0)), (9.6, 0.0, -3.0), point((9.6, 0.0, -3.0))),
        (point((10.0, 0.0, -3.0)), (10.0, 3.0, -3.0), point((10.0, 1.0, -3.0))),
        (Target(None, (0.5, 2.0, 0.0), None, 0.0), INSIDE, Target(None, (-1.0, 2.0, 0.0), None, 0.0)),
        (
            Target((10.0, 0.0, -3.0), (0.6, 0.0, 0.0), None, 0.0),
            INSIDE,
            Target((8.4, 0.0, -3.0), (0.6, 0.0, 0.0), None, 0.0),
        ),
    ],
)
def test_a_vehicle_outside_is_led_in_at_1_mps_whatever_its_target_is(
    target: Target, inside_ned_m: Vec3, expected: Target
) -> None:
    """A point that is 1 m away leads at 1 m/s; nearer than that to the point inside, the vehicle gets slower."""
    led = inward_target(target, OUTSIDE, inside_ned_m)
    assert led.pos_ned_m == (None if expected.pos_ned_m is None else pytest.approx(expected.pos_ned_m))
    assert led.vel_ned_mps == (None if expected.vel_ned_mps is None else pytest.approx(expected.vel_ned_mps))


@pytest.mark.parametrize(
    "target",
    [
        point((8.5, 0.0, -3.0)),
        Target(None, (-1.5, 2.0, 0.0), None, 0.0),
        Target((9.5, 0.0, -3.0), (-0.7, 0.0, 0.0), None, 0.0),
    ],
)
def test_a_target_that_leads_a_vehicle_inside_by_itself_is_not_changed(target: Target) -> None:
    assert inward_target(target, OUTSIDE, INSIDE) is target
    assert inward_target(target, INSIDE, INSIDE) is target, "it is there"


def test_an_edge_holds_back_a_way_that_meets_it_before_the_vehicle_has_stopped_and_no_other() -> None:
    """From 2.5 m/s it stops in 3.125 m, 1.9 m west of the middle of the crater's edge and 0.37 or 0.53 m south of it;
    0.4 m are kept. The crater's corner is 3.16 m away, and √(2 · 2.76) = 2.35 m/s are permitted towards it."""
    vehicle = at((3.0, -5.0, -3.0))
    passes_by, meets = speed((0.375, 2.4725, 0.0)), speed((0.5, 2.45, 0.0))
    assert limited_target(FENCE, LIMITS, passes_by, vehicle, floor_holds=True) == (passes_by, "")
    assert "'crater'" in limited_target(FENCE, LIMITS, meets, vehicle, floor_holds=True)[1]


def test_the_speed_along_the_fence_stays() -> None:
    limited, _ = limited_target(FENCE, LIMITS, speed((2.0, 9.0, 0.0)), at((0.0, 19.6, -3.0)), floor_holds=True)
    assert limited.vel_ned_mps == pytest.approx((2.0, 0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("towards", [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
def test_a_vehicle_that_is_too_fast_to_stop_brakes_and_nothing_else(towards: tuple[float, float]) -> None:
    """1 m before the fence √(2 · 0.6) m/s are permitted; the speed along the fence stays."""
    north, east = towards
    vehicle = at((19.0 * north, 19.0 * east, -3.0), (5.0 * north + 0.5 * east, 5.0 * east + 0.5 * north, 0.0))
    away = Target((0.0, 0.0, -2.0), None, None, 0.0)
    limited, reason = limited_target(FENCE, LIMITS, speed((9.0 * north, 9.0 * east, 0.3)), vehicle, floor_holds=True)
    permitted_mps = sqrt(1.2)
    assert "'field'" in reason
    assert limited.vel_ned_mps == pytest.approx(
        (permitted_mps * north + 0.5 * east, permitted_mps * east + 0.5 * north, 0.3), abs=0.01
    )
    limited, _ = limited_target(FENCE, LIMITS, away, vehicle, floor_holds=True)
    assert limited.vel_ned_mps is not None and limited.pos_ned_m is not None
    assert limited.vel_ned_mps[0] * north + limited.vel_ned_mps[1] * east < 0.0, "a target behind it is obeyed"
    assert limited.pos_ned_m == pytest.approx((19.0 * north, 19.0 * east, -2.0)), "only its height is kept"


@pytest.mark.parametrize(("lead_m", "vel_mps"), [(0.0, 2.0), (0.5, 1.5), (1.0, 1.0), (3.0, 0.0), (-1.0, 2.0)])
def test_point_and_velocity_together_lead_no_faster_to_the_fence_than_the_vehicle_can_stop(
    lead_m: float, vel_mps: float
) -> None:
    """2.4 m before the fence 2 m/s are permitted. The autopilot makes up to 1 m/s of a point that is 1 m away; one on
    the other side makes the vehicle no faster."""
    target = Target((0.0, 17.6 + lead_m, -3.0), (0.0, 5.0, 0.0), None, 0.0)
    limited, _ = limited_target(FENCE, LIMITS, target, at((0.0, 17.6, -3.0)), floor_holds=True)
    assert limited.pos_ned_m == pytest.approx((0.0, 17.6 + min(lead_m, 2.0), -3.0))
    assert limited.vel_ned_mps == pytest.approx((0.0, vel_mps, 0.0), abs=2e-3)


def test_a_vehicle_that_comes_near_the_fence_no_faster_than_permitted_stops_where_its_target_says() -> None:
    """2.4 m before the fence 2 m/s are permitted; it flies at 1 m/s towards it, and at 6 m/s along it."""
    vehicle, stop = at((0.0, 17.6, -3.0), (6.0, 1.0, 0.0)), speed((0.0, 0.0, 0.0))
    assert limited_target(FENCE, LIMITS, stop, vehicle, floor_holds=True) == (stop, "")
    faster = at((0.0, 17.6, -3.0), (6.0, 3.0, 0.0))
    limited, reason = limited_target(FENCE, LIMITS, stop, faster, floor_holds=True)
    assert limited.vel_ned_mps == pytest.approx((6.0, 0.0, 0.0)), "all of its tilt serves to brake"
    assert "'field'" in reason


def test_the_floor_does_not_hold_in_a_landing() -> None:
    down = speed((0.0, 0.0, 1.0))
    vehicle = at((0.0, 0.0, -1.0))
    assert limited_target(FENCE, LIMITS, down, vehicle, floor_holds=False)[0] is down
    limited, reason = limited_target(FENCE, LIMITS, down, vehicle, floor_holds=True)
    assert limited.vel_ned_mps == pytest.approx((0.0, 0.0, 0.0))
    assert "floor" in reason


def follow(vel: Vec3, wanted: Vec3, dt: float) -> Vec3:
    """Velocity after a step of a vehicle with a lag of 0.3 s, at most 12 m/s, 4 m/s² horizontally and 3 vertically."""
    share = min(1.0, 12.0 / max(hypot(*wanted[:2]), 1e-9))
    climb = min(max(wanted[2], -3.0), 1.5)
    north, east = ((share * wanted[i] - vel[i]) / 0.3 for i in (0, 1))
    tilt = min(1.0, 4.0 / max(hypot(north, east), 1e-9))
    down = min(max((climb - vel[2]) / 0.3, -3.0), 3.0)
    return add(vel, scale((tilt * north, tilt * east, down), dt))


@pytest.mark.parametrize("seed", range(10))
def test_no_target_carries_a_vehicle_that_follows_it_through_the_fence(seed: int) -> None:
    random, dt = Random(seed), 0.02
    pos, vel = (0.0, 0.0, -3.0), (0.0, 0.0, 0.0)
    worst_m, target = 1e9, speed((0.0, 0.0, 0.0))
    for step in range(1000):
        if step % 100 == 0:
            v = (random.uniform(-10, 10), random.uniform(-10, 10), random.uniform(-2, 2))
            far = (random.uniform(-40, 40), random.uniform(-40, 40), random.uniform(-20, -1))
            target = random.choice((point(far), speed(v), Target(far, v, None, 0.0)))
        limited, _ = limited_target(FENCE, LIMITS, target, at(pos, vel), floor_holds=True)
        wanted = limited.vel_ned_mps or (0.0, 0.0, 0.0)
        if limited.pos_ned_m is not None:
            wanted = add(wanted, scale(subtract(limited.pos_ned_m, pos), 0.95))
        vel = follow(vel, wanted, dt)
        pos = add(pos, scale(vel, dt))
        edge = nearest(FENCE, pos)
        assert edge is not None
        worst_m = min(worst_m, edge.inside_m, 10.0 + pos[2])
    assert worst_m > 0.0
