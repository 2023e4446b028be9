"""A measured path that differs from the motion of vehicle and rover is explained by a turn, a length, or a speed."""

from math import cos, pi, sin

import pytest

from jezero.services.estimator.motion_check import AGREES, MotionCheck, PathDifference, PathSample

MS = 1_000_000
STEP_S = 0.25


def after_motion(
    turn_rad: float = 0.0,
    factor: float = 1.0,
    std_m: float = 0.02,
    *,
    speed_mps: float = 0.8,
    rover_faster_mps: float = 0.0,
    rover_yaw_rad: float = 0.5 * pi,
    duration_s: float = 5.0,
) -> PathDifference:
    """Contradiction after a flight to the north past a rover that should stand.

    Args:
        turn_rad: turn of the measured path.
        factor: length of the measured path over that of the flown one.
        std_m: standard deviation of the measured places.
        speed_mps: speed of the vehicle.
        rover_faster_mps: speed of the rover, of which its odometry knows nothing.
        rover_yaw_rad: heading of the rover.
        duration_s: time of the flight.
    """
    check = MotionCheck()
    for i in range(int(duration_s / STEP_S)):
        t_s = STEP_S * i
        north_m, rover_m = speed_mps * t_s, rover_faster_mps * t_s
        way_m = t_s * cos(rover_yaw_rad), t_s * sin(rover_yaw_rad)
        measured_m = (
            factor * north_m * cos(turn_rad) + 3.0 - rover_m * cos(rover_yaw_rad),
            factor * north_m * sin(turn_rad) - 1.0 - rover_m * sin(rover_yaw_rad),
        )
        check.add(PathSample(int(t_s * 1000) * MS, (north_m, 0.0), way_m, measured_m, std_m))
    return check.contradiction


def test_a_path_turned_by_90_degrees_contradicts_the_motion_and_names_the_angle() -> None:
    found = after_motion(0.5 * pi, rover_yaw_rad=0.3)
    assert found.text == "turned by 90 degrees against the motion of vehicle and rover and 1.0 times as long"
    assert found.turn_rad == pytest.approx(0.5 * pi)
    assert found.speed_error_mps == 0.0


def test_a_path_of_twice_the_length_contradicts_the_motion_without_a_turn() -> None:
    found = after_motion(0.0, 2.0)
    assert found.text.endswith("2.0 times as long")
    assert (found.turn_rad, found.speed_error_mps) == (0.0, 0.0)


@pytest.mark.parametrize("faster_mps", [0.6, -1.0])
@pytest.mark.parametrize("rover_yaw_rad", [0.5 * pi, 0.3])
def test_a_rover_that_drives_at_another_speed_than_its_odometry_says_is_found_with_the_difference(
    faster_mps: float, rover_yaw_rad: float
) -> None:
    found = after_motion(rover_faster_mps=faster_mps, rover_yaw_rad=rover_yaw_rad)
    assert found.speed_error_mps == pytest.approx(faster_mps)
    assert found.turn_rad == 0.0
    assert f"{abs(faster_mps):.1f} m/s {'faster' if faster_mps > 0 else 'slower'}" in found.text


def test_a_rover_that_drives_a_quarter_as_fast_as_the_vehicle_flies_beside_it_is_found_too() -> None:
    """The measured path is as long as the flown one within what is normal."""
    found = after_motion(speed_mps=2.0, rover_faster_mps=0.5, rover_yaw_rad=0.0)
    assert found.speed_error_mps == pytest.approx(0.5)


def test_a_vehicle_that_hovers_finds_the_speed_of_the_rover_too() -> None:
    assert after_motion(speed_mps=0.0, rover_faster_mps=0.5).speed_error_mps == pytest.approx(0.5)


@pytest.mark.parametrize(
    "flight",
    [
        {},
        {"turn_rad": 0.2, "factor": 1.1},
        {"turn_rad": 0.5 * pi, "std_m": 2.0},
        {"turn_rad": 0.5 * pi, "speed_mps": 0.08},
        {"rover_faster_mps": 0.2},
        {"rover_faster_mps": 0.6, "std_m": 2.0},
        {"turn_rad": 0.5 * pi, "duration_s": 1.5},
    ],
    ids=["right", "nearly right", "uncertain", "hardly any motion", "some slip", "uncertain speed", "short"],
)
def test_what_a_path_cannot_show_is_no_contradiction(flight: dict[str, float]) -> None:
    assert after_motion(**flight) == AGREES


def test_a_path_is_as_uncertain_as_its_worst_place() -> None:
    check = MotionCheck()
    for i in range(20):
        std_m = 4.0 if i == 10 else 0.02
        check.add(PathSample(250 * i * MS, (0.2 * i, 0.0), (0.0, 0.25 * i), (0.0, 0.2 * i), std_m))
    assert check.contradiction == AGREES
