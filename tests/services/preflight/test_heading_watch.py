"""A compass that the vehicle's motion has contradicted in flight stays named."""

from msgspec.structs import replace

from jezero.base.frames import quat_from_euler
from jezero.schemas.state import Status
from jezero.services.preflight.heading_watch import HeadingWatch
from jezero.services.preflight.sensor_checks import check_compass
from tests.services.preflight.healthy import readings, status


def turned(yaw_rad: float, resets: int, *, flies: bool) -> Status:
    odometry = status().odometry
    assert odometry is not None
    attitude = quat_from_euler(0.0, 0.0, yaw_rad)
    return status(
        armed=flies, landed=not flies, odometry=replace(odometry, q_ned_from_frd=attitude, reset_counter=resets)
    )


def test_a_reset_of_the_heading_in_flight_fails_the_check_also_after_the_landing() -> None:
    watch = HeadingWatch()
    for each in (turned(0.5, 0, flies=True), turned(2.0, 1, flies=True), turned(2.0, 1, flies=False)):
        watch.update(each)
    assert "contradicted the compass by 86°" in watch.problem
    check = check_compass(readings(compass_problem=watch.problem))
    assert (check.verdict, check.text) == ("failed", watch.problem)


def test_a_reset_on_the_ground_and_a_turn_in_flight_are_normal() -> None:
    watch = HeadingWatch()
    for each in (turned(0.5, 0, flies=False), turned(2.0, 1, flies=False), turned(2.0, 1, flies=True)):
        watch.update(each)
    watch.update(turned(0.5, 1, flies=True))
    assert watch.problem == ""


def test_a_reset_is_judged_only_of_an_armed_vehicle_in_the_air_whose_position_is_known() -> None:
    before, after = turned(0.5, 0, flies=True), turned(2.0, 1, flies=True)
    for first, second in (
        (replace(before, landed=True), replace(after, landed=True)),
        (replace(before, armed=False), replace(after, armed=False)),
        (replace(before, odometry=None), after),
        (before, replace(after, odometry=None)),
    ):
        watch = HeadingWatch()
        watch.update(first)
        watch.update(second)
        assert watch.problem == ""
