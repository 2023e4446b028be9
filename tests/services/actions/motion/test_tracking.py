"""Tracking: a vehicle with wind and a late velocity loop stays on a moving reference; one that can't is waited for."""

from math import cos, hypot, sin

import pytest

from jezero.base.frames import Vec3, add, scale, subtract
from jezero.services.actions.motion.behaviour import VehicleState
from jezero.services.actions.motion.config import TrackingConfig
from jezero.services.actions.motion.straight_path import TimedStraightPath
from jezero.services.actions.motion.tracking import (
    CORRECTION_MAX_MPS,
    INTEGRAL_MAX_MPS,
    Reference,
    Tracker,
)

LEVEL = (1.0, 0.0, 0.0, 0.0)

CONFIG = TrackingConfig()
DT_NS = 10_000_000
DT_S = 0.01


def circle(time_s: float) -> Reference:
    """2 m in radius, at 1 m/s, 4 m up."""
    c, s = cos(0.5 * time_s), sin(0.5 * time_s)
    return Reference((2.0 * c, 2.0 * s, -4.0), (-s, c, 0.0), (-0.5 * c, -0.5 * s, 0.0))


class LaggingVehicle:
    """Its velocity follows setpoints with a time constant of 0.25 s, off by a constant disturbance."""

    def __init__(self, pos_ned_m: Vec3, disturbance_mps: Vec3 = (0.0, 0.0, 0.0), *, held: bool = False) -> None:
        self.pos, self.vel, self.disturbance, self.held = pos_ned_m, (0.0, 0.0, 0.0), disturbance_mps, held

    def fly(self, velocity: Vec3, acceleration: Vec3) -> None:
        if not self.held:
            pull = scale(subtract(add(velocity, self.disturbance), self.vel), 4.0)
            self.vel = add(self.vel, scale(add(pull, acceleration), DT_S))
            self.pos = add(self.pos, scale(self.vel, DT_S))

    @property
    def state(self) -> VehicleState:
        return VehicleState(self.pos, self.vel, LEVEL, armed=True, landed=False)


def track(vehicle: LaggingVehicle, seconds: float) -> tuple[Tracker, list[float]]:
    """The tracker, and the horizontal error at each step."""
    tracker, errors, t_ns = Tracker(0, CONFIG), [], 0
    for _ in range(int(seconds / DT_S)):
        t_ns += DT_NS
        dt_s = tracker.advance(t_ns, circle(tracker.time_s), vehicle.state)
        reference = circle(tracker.time_s)
        vehicle.fly(*tracker.command(dt_s, reference, vehicle.state))
        errors.append(hypot(*subtract(reference.pos_ned_m, vehicle.pos)[:2]))
    return tracker, errors


def test_the_vehicle_stays_on_the_circle_also_when_something_pushes_it_aside() -> None:
    tracker, errors = track(LaggingVehicle((2.0, 0.0, -4.0), (0.2, -0.1, 0.0)), 30.0)
    assert tracker.time_s == pytest.approx(30.0, abs=0.2)
    assert max(errors[1000:]) < 0.05


def test_the_reference_waits_for_a_vehicle_that_does_not_move_and_says_so_in_the_end() -> None:
    tracker, _ = track(LaggingVehicle((2.0, 0.0, -4.0), held=True), 19.0)
    assert tracker.rate < 1e-3 and tracker.time_s < 1.5 and tracker.stuck(int(19e9)) == ""
    tracker, _ = track(LaggingVehicle((2.0, 0.0, -4.0), held=True), 30.0)
    assert tracker.stuck(int(30e9)).startswith("no progress for 2")


def test_a_server_that_was_frozen_does_not_jump_ahead() -> None:
    tracker, vehicle = Tracker(0, CONFIG), LaggingVehicle((2.0, 0.0, -4.0))
    tracker.advance(int(60e9), circle(0.0), vehicle.state)
    assert tracker.time_s == pytest.approx(0.1)


def test_the_position_is_carried_on_from_when_it_was_measured() -> None:
    tracker = Tracker(0, CONFIG)
    behind = VehicleState((1.9, -0.1, -4.0), (1.0, 1.0, 0.0), LEVEL, armed=True, landed=False, age_s=0.1)
    here = VehicleState((2.0, 0.0, -4.0), (1.0, 1.0, 0.0), LEVEL, armed=True, landed=False)
    for late, now in zip(
        tracker.command(0.0, circle(0.0), behind), tracker.command(0.0, circle(0.0), here), strict=True
    ):
        assert late == pytest.approx(now)


def test_a_distant_vehicle_gets_bounded_commands() -> None:
    tracker = Tracker(0, CONFIG)
    away = VehicleState((90.0, 60.0, 0.0), (9.0, 9.0, -9.0), LEVEL, armed=True, landed=False)
    tracker.advance(DT_NS, circle(0.0), away)
    velocity, acceleration = tracker.command(DT_S, circle(0.0), away)
    assert hypot(*velocity) <= CORRECTION_MAX_MPS + INTEGRAL_MAX_MPS + 1e-9
    assert hypot(*acceleration) <= CONFIG.acceleration_max_mps2 + 1e-9


def test_a_vehicle_that_never_gets_to_the_end_of_the_reference_is_stuck() -> None:
    """It is near enough for the reference to go on, but something holds it before the end, such as a fence."""
    path = TimedStraightPath((0.0, 0.0, -4.0), (0.0, 0.0, -6.0), 1.0, 1.0)
    tracker, t_ns = Tracker(0, CONFIG), 0
    while t_ns < 30e9 and not tracker.stuck(t_ns):
        t_ns += DT_NS
        at_m = path.at(tracker.time_s).pos_ned_m
        vehicle = LaggingVehicle((0.0, 0.0, max(at_m[2], -5.3)), held=True)
        tracker.advance(t_ns, path.at(tracker.time_s), vehicle.state)
    assert tracker.time_s > path.profile.duration_s
    assert tracker.stuck(t_ns) == "no progress for 20 s: 0.7 m from the reference"
