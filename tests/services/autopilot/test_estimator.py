"""The filter on a made-up flight whose truth is known: consistent, bounded, late fixes, steps and resets."""

from collections.abc import Callable
from dataclasses import replace
from math import degrees, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.base.frames import (
    Vec3,
    add,
    distance,
    geodetic_from_ned,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
)
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.estimator import StateEstimator
from tests.services.autopilot.made_up_flight import CONFIG, DT_US, ORIGIN, REST_S, G, World, pose


def test_with_perfect_sensors_the_estimate_is_the_truth() -> None:
    error = np.abs(World().run(30.0).error())
    assert degrees(error[0:3].max()) < 0.2
    assert error[3:6].max() < 0.02
    assert error[6:9].max() < 0.02


def test_the_filter_knows_how_wrong_it_is() -> None:
    """Mean NEES of 12 flights within the 99.8 % bounds of chi-squared with 12 x 15 degrees of freedom."""
    nees = []
    for seed in range(12):
        world = World(seed).run(18.0)
        error = world.error()
        nees.append(float(error @ np.linalg.solve(world.estimator.P, error)))
    assert 10.5 < sum(nees) / len(nees) < 20.3


@pytest.mark.parametrize("seed", [3, 4])
def test_biases_are_found(seed: int) -> None:
    world = World(seed).run(40.0)
    assert distance(world.estimator.gyro_bias_rps, world.gyro_bias) < 0.003
    assert abs(world.estimator.acc_bias_mps2[2] - world.acc_bias[2]) < 0.05


def test_heading_counts_from_true_north() -> None:
    world = World().run(REST_S)
    assert world.estimator.yaw_rad == pytest.approx(0.4, abs=radians(0.1))


def test_the_local_frame_starts_where_the_filter_started() -> None:
    world = World().run(REST_S)
    assert world.estimator.origin_deg == pytest.approx(ORIGIN)
    assert norm(world.estimator.pos_ned_m) < 0.01


@pytest.mark.parametrize("delay_s", [0.02, 0.4, 1.1])
def test_late_fixes_do_not_matter_as_they_tell_when_they_were_true(delay_s: float) -> None:
    world = World().run(8.0)
    world.gnss_delay_s = delay_s
    world.run(30.0)
    error = np.abs(world.error())
    assert degrees(error[0:3].max()) < 0.2
    assert error[3:6].max() < 0.02
    assert error[6:9].max() < 0.02
    assert world.estimator.reset_counter == 0


def test_fixes_without_a_time_are_as_late_as_the_settings_say() -> None:
    world = World()
    world.dates_fixes = False
    assert np.abs(world.run(30.0).error()[3:9]).max() < 0.02
    world.gnss_delay_s = 0.5
    assert np.abs(world.run(60.0).error()[3:9]).max() > 0.1


def test_a_fix_that_is_far_off_is_ignored_and_then_believed_when_it_insists() -> None:
    world = World(shift_ned_m=lambda t: (1.5, 0.0, 0.0) if t > 8.0 else (0.0, 0.0, 0.0)).run(10.9)
    assert abs(world.error()[6]) < 0.1
    assert "away from the estimate" in world.estimator.invalid_reason
    assert world.estimator.reset_counter == 0
    world.run(11.3)
    assert world.estimator.reset_counter == 1
    assert world.estimator.reset_offset_ned_m == pytest.approx((1.5, 0.0, 0.0), abs=0.05)
    assert world.error()[6] == pytest.approx(-1.5, abs=0.1)
    assert world.estimator.invalid_reason == ""


def test_a_short_step_of_the_fixes_leaves_no_trace() -> None:
    world = World(shift_ned_m=lambda t: (0.0, -2.0, 0.0) if 8.0 < t < 10.5 else (0.0, 0.0, 0.0)).run(15.0)
    assert world.estimator.reset_counter == 0
    assert norm((world.error()[6], world.error()[7], 0.0)) < 0.1


@pytest.mark.parametrize("sensor", ["on_baro", "on_fix"])
def test_a_sensor_that_jumps_about_is_never_believed_and_one_that_insists_is(sensor: str) -> None:
    world, rng = World().run(8.0), np.random.default_rng(1)
    estimator = world.estimator
    pass_on = getattr(estimator, sensor)
    shift_m = 0.0

    def shifted(reading: Any) -> None:
        if sensor == "on_baro":
            pass_on(reading + shift_m)
        else:
            latitude_deg, longitude_deg, up_m = reading.position_deg
            pass_on(replace(reading, position_deg=(latitude_deg + shift_m / 111_195.0, longitude_deg, up_m)))

    def garbled(reading: Any) -> None:
        nonlocal shift_m
        shift_m = float(rng.uniform(-500.0, 500.0))
        shifted(reading)

    setattr(estimator, sensor, garbled)
    world.run(16.0)
    assert estimator.reset_counter == 0
    assert norm(tuple(world.error()[6:9])) < 0.5
    setattr(estimator, sensor, shifted)
    world.run(20.0)
    assert estimator.reset_counter == 1
    assert norm(tuple(world.error()[6:9])) == pytest.approx(abs(shift_m), rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_without_gnss_it_stays_level_and_its_velocity_near_that_of_a_slow_vehicle(seed: int) -> None:
    world = World(seed).run(20.0)
    world.has_gnss = False
    for _ in range(60):
        world.run(world.t_s + 1.0)
        error = np.abs(world.error())
        assert degrees(error[0:2].max()) < 2.0
        assert error[3:5].max() < 3.0
    world.has_gnss = True
    world.run(world.t_s + 15.0)
    assert np.abs(world.error())[6:8].max() < 1.0


def test_a_field_that_can_not_be_the_places_does_not_turn_the_heading(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World().run(8.0)
    mag = world.estimator.on_mag
    monkeypatch.setattr(world.estimator, "on_mag", lambda field: mag(add(field, (0.18, -0.18, 0.0))))
    world.run(18.0)
    assert degrees(abs(world.error()[2])) < 2.0


def test_a_heading_that_is_far_off_is_found_again() -> None:
    world = World().run(8.0)
    estimator = world.estimator
    estimator.q_ned_from_frd = quat_multiply(quat_from_euler(0.0, 0.0, 1.2), estimator.q_ned_from_frd)
    world.run(10.5)
    assert "the magnetometer's heading is" in estimator._rejection_reason
    world.run(25.0)
    assert degrees(abs(world.error()[2])) < 4.0
    assert estimator.invalid_reason == ""


def turned(world: World, angle_rad: float) -> Callable[[Vec3], None]:
    """The filter's input for a compass that is wrong by an angle, positive to the right."""
    mag = world.estimator.on_mag

    def on_mag(field_frd_gauss: Vec3) -> None:
        q = pose(world.t_s)[1]
        field_ned = quat_rotate(quat_from_euler(0.0, 0.0, -angle_rad), quat_rotate(q, field_frd_gauss))
        mag(quat_rotate(quat_conjugate(q), field_ned))

    return on_mag


@pytest.mark.parametrize("angle_deg", [30.0, 45.0, -45.0, 90.0, 180.0])
def test_a_compass_that_jumps_in_the_air_does_not_turn_the_heading(
    angle_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(seed=1).run(8.0)
    world.estimator.on_landed(False)
    monkeypatch.setattr(world.estimator, "on_mag", turned(world, radians(angle_deg)))
    world.run(60.0)
    assert degrees(abs(world.error()[2])) < 5.0
    assert world.estimator.reset_counter == 0
    assert "the magnetometer's heading is" in world.estimator.invalid_reason


def test_a_compass_that_drifts_away_in_the_air_is_overruled_by_the_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow enough for the gate, 60 degrees in 40 s."""
    world = World(seed=1).run(8.0)
    world.estimator.on_landed(False)
    mag = world.estimator.on_mag
    errors_deg = []
    for step in range(80):
        monkeypatch.setattr(world.estimator, "on_mag", mag)  # otherwise the angles would add up
        monkeypatch.setattr(world.estimator, "on_mag", turned(world, radians(min(60.0, 1.5 * step))))
        world.run(world.t_s + 0.5)
        errors_deg.append(degrees(abs(world.error()[2])))
    assert max(errors_deg) < 40.0
    world.run(80.0)
    assert degrees(abs(world.error()[2])) < 20.0


@pytest.mark.parametrize("angle_rad", [0.7, -1.2, 3.0])
def test_a_heading_that_was_wrong_at_takeoff_is_found_by_the_motion_and_not_by_the_compass(
    angle_rad: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(seed=2)
    monkeypatch.setattr(world.estimator, "on_mag", turned(world, angle_rad))
    world.run(REST_S + 1.0)
    assert abs(world.error()[2]) > 0.5
    world.estimator.on_landed(False)
    world.run(45.0)
    assert degrees(abs(world.error()[2])) < 20.0


@pytest.mark.parametrize("seed", range(6))
def test_a_right_heading_is_not_reset_by_the_motion(seed: int) -> None:
    world = World(seed).run(8.0)
    world.estimator.on_landed(False)
    world.run(40.0)
    assert world.estimator.reset_counter == 0


def test_in_a_disturbed_field_it_does_not_start_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    mag = world.estimator.on_mag
    monkeypatch.setattr(world.estimator, "on_mag", lambda field: mag(add(field, (0.1, -0.1, 0.0))))
    world.run(REST_S)
    assert world.estimator.invalid_reason == "the magnetic field is disturbed"


def test_a_shock_that_kicks_the_velocity_is_forgotten() -> None:
    world = World().run(8.0)
    for _ in range(10):
        world.step += 1
        world.estimator.on_imu(world.step * DT_US, (60.0, 0.0, -140.0), (0.0, 0.0, 0.0))
    assert norm(tuple(world.error()[3:6])) > 3.0
    world.run(20.0)
    assert norm(tuple(world.error()[3:6])) < 0.1
    assert norm(tuple(world.error()[6:9])) < 0.3
    assert world.estimator.reset_counter > 0


@pytest.mark.parametrize(
    ("sensor", "text"),
    [("on_fix", "no GNSS fix yet"), ("on_mag", "no magnetometer data"), ("on_baro", "no barometer data")],
)
def test_without_a_sensor_it_does_not_start_and_says_which(sensor: str, text: str) -> None:
    world = World()
    setattr(world.estimator, sensor, lambda _: None)
    world.run(REST_S)
    assert not world.estimator.running
    assert world.estimator.invalid_reason == text


def test_a_moving_vehicle_is_not_aligned() -> None:
    estimator = StateEstimator(CONFIG, G)
    for step in range(1, 1000):
        estimator.on_imu(step * DT_US, (0.0, 0.0, -G), (0.0, 0.0, 0.5))
    assert not estimator.running
    assert "moves" in estimator.invalid_reason


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["imu", "fix", "baro", "mag"]),
            st.tuples(*[st.floats(-1000.0, 1000.0)] * 3),
            st.tuples(*[st.floats(-35.0, 35.0)] * 3),
        ),
        max_size=60,
    )
)
def test_no_reading_makes_the_estimate_anything_but_finite(inputs: list[tuple[str, Vec3, Vec3]]) -> None:
    world = World().run(REST_S)
    e = world.estimator
    for kind, first, second in inputs:
        world.step += 5
        if kind == "imu":
            e.on_imu(world.step * DT_US, first, second)
        elif kind == "fix":
            e.on_fix(Fix(world.step * DT_US, geodetic_from_ned(first, ORIGIN), second, valid=True))
        elif kind == "baro":
            e.on_baro(first[0])
        else:
            e.on_mag(tuple(np.cross(first, second).tolist()))
    values = [*e.pos_ned_m, *e.vel_ned_mps, *e.q_ned_from_frd, *e.gyro_bias_rps, *e.acc_bias_mps2, *e.P.flat]
    assert np.isfinite(values).all()
    assert (np.diag(e.P) >= 0.0).all()
