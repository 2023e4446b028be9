"""Of the three heights of a takeoff, the one that differs is named."""

from math import pi

import pytest
from msgspec.structs import replace

from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.sensors import Altimeter, Barometer
from jezero.schemas.state import Status
from jezero.services.preflight.height_watch import HeightWatch
from jezero.services.preflight.sensor_checks import check_sensors
from tests.services.preflight.healthy import readings, status

S = 1_000_000_000
HOME_BAROMETER_M = 488.0


def at(t_s: float, height_m: float, *, armed: bool = True, north_m: float = 0.0, step_m: float = 0.0) -> Status:
    """A status at a height above the takeoff; the autopilot has moved its estimate up by step_m so far."""
    t_ns = round(t_s * S)
    plain = status()
    assert plain.odometry is not None
    odometry = replace(
        plain.odometry,
        t_ns=t_ns,
        pos_uav_ned_m=(north_m, 0.0, -height_m - step_m),
        reset_offset_ned_m=(0.0, 0.0, -step_m),
    )
    return replace(plain, t_ns=t_ns, armed=armed, landed=height_m == 0.0, odometry=odometry)


def climbed(
    height_m: float,
    *,
    range_m: float | None,
    barometer_m: float,
    way_m: float = 0.0,
    step_m: float = 0.0,
    hovers_s: float = 3.0,
) -> HeightWatch:
    """The watch after a takeoff to a height, and some seconds there."""
    watch = HeightWatch(VehicleConfig())
    stands = Barometer(t_ns=0, pressure_pa=95_000.0, altitude_pressure_m=HOME_BAROMETER_M, temperature_degc=15.0)
    for tenth in range(10):
        watch.update(at(0.1 * tenth, 0.0), [Altimeter(t_ns=0)], [stands])
    for tenth in range(10, 10 + round(10 * hovers_s) + 1):
        there = replace(stands, altitude_pressure_m=HOME_BAROMETER_M + barometer_m)
        state = at(0.1 * tenth, height_m, north_m=way_m, step_m=step_m)
        watch.update(state, [Altimeter(t_ns=0, range_m=range_m)], [there])
    return watch


@pytest.mark.parametrize(
    ("range_m", "barometer_m", "named"),
    [
        (0.2, 3.1, "by the altimeter 0.2 m: the altimeter is wrong"),
        (8.0, 2.6, "by the altimeter 8.0 m: the altimeter is wrong"),
        (None, 2.6, "the altimeter measures nothing"),
        (3.0, 0.0, "by the barometer 0.0 m, by the altimeter 3.0 m: the barometer is wrong"),
        (0.2, 0.1, "at least two of them are wrong"),
    ],
)
def test_the_height_that_differs_from_the_others_is_named(
    range_m: float | None, barometer_m: float, named: str
) -> None:
    watch = climbed(3.0, range_m=range_m, barometer_m=barometer_m)
    assert named in watch.problem
    check = check_sensors(readings(height_problem=watch.problem))
    assert check.verdict == "failed" and named in check.text


@pytest.mark.parametrize(
    ("range_m", "barometer_m", "wrong"),
    [
        (2.2, 3.0, ""),  # 0.8 m for the platform and its margin, and a tenth of the height: 1.1 m in all at 3 m
        (1.8, 3.0, "altimeter"),
        (3.8, 3.0, ""),
        (4.2, 3.0, "altimeter"),
        (3.0, 0.8, ""),  # 2.3 m
        (3.0, 0.6, "barometer"),
        (3.0, 5.2, ""),
        (3.0, 5.4, "barometer"),
    ],
)
def test_small_differences_are_normal_and_grow_with_the_height(range_m: float, barometer_m: float, wrong: str) -> None:
    problem = climbed(3.0, range_m=range_m, barometer_m=barometer_m).problem
    assert f"the {wrong} is wrong" in problem if wrong else problem == ""


@pytest.mark.parametrize(("height_m", "judged"), [(1.4, False), (1.6, True)])
def test_heights_are_compared_from_a_metre_and_a_half_on(height_m: float, judged: bool) -> None:
    assert bool(climbed(height_m, range_m=8.0, barometer_m=height_m).problem) is judged


def test_a_climb_without_readings_of_the_barometer_is_judged_by_the_altimeter() -> None:
    watch = HeightWatch(VehicleConfig())
    for tenth in range(10):
        watch.update(at(0.1 * tenth, 0.0), [Altimeter(t_ns=0)], [])
    for tenth in range(10, 40):
        watch.update(at(0.1 * tenth, 3.0), [Altimeter(t_ns=0, range_m=0.2)], [])
    assert "by the altimeter 0.2 m: the altimeter is wrong" in watch.problem
    assert "barometer" not in watch.problem


def test_a_platform_under_the_beam_a_reset_of_the_height_and_moving_air_are_normal() -> None:
    assert climbed(3.0, range_m=2.5, barometer_m=3.0).problem == ""
    assert climbed(3.0, range_m=3.5, barometer_m=1.5).problem == ""
    assert climbed(3.0, range_m=3.0, barometer_m=3.0, step_m=4.0).problem == ""


@pytest.mark.parametrize(("hovers_s", "named"), [(0.8, False), (1.4, True)])
def test_a_difference_of_less_than_a_second_is_normal(hovers_s: float, named: bool) -> None:
    assert bool(climbed(3.0, range_m=0.2, barometer_m=3.0, hovers_s=hovers_s).problem) is named


def test_short_differences_are_normal_however_many_they_are() -> None:
    watch = HeightWatch(VehicleConfig())
    watch.update(at(0.0, 0.0), [Altimeter(t_ns=0)], [])
    for tenth in range(1, 60):
        wrong = tenth % 10 < 8
        watch.update(at(0.1 * tenth, 3.0), [Altimeter(t_ns=0, range_m=0.2 if wrong else 3.0)], [])
    assert watch.problem == ""
    for tenth in range(60, 120):
        high = tenth % 10 < 8
        watch.update(at(0.1 * tenth, 3.0 if high else 1.0), [Altimeter(t_ns=0, range_m=0.2)], [])
    assert watch.problem == ""


def test_a_barometer_that_is_first_heard_in_the_air_is_not_compared() -> None:
    watch = HeightWatch(VehicleConfig())
    for tenth in range(10):
        watch.update(at(0.1 * tenth, 0.0), [Altimeter(t_ns=0)], [])
    for tenth in range(10, 40):
        air = Barometer(t_ns=0, pressure_pa=95_000.0, altitude_pressure_m=HOME_BAROMETER_M, temperature_degc=15.0)
        watch.update(at(0.1 * tenth, 3.0), [Altimeter(t_ns=0, range_m=0.2)], [air])
    assert "by the altimeter 0.2 m: the altimeter is wrong" in watch.problem
    assert "barometer" not in watch.problem


def test_an_autopilot_that_loses_its_position_in_the_takeoff_ends_the_comparison() -> None:
    watch = HeightWatch(VehicleConfig())
    watch.update(at(0.0, 0.0), [Altimeter(t_ns=0)], [])
    watch.update(at(0.1, 3.0), [Altimeter(t_ns=0, range_m=0.2)], [])
    watch.update(replace(at(0.2, 3.0), odometry=None), [Altimeter(t_ns=0, range_m=0.2)], [])
    for tenth in range(3, 40):
        watch.update(at(0.1 * tenth, 3.0), [Altimeter(t_ns=0, range_m=0.2)], [])
    assert (watch.problem, watch.listens) == ("", False)


def test_the_range_of_a_tilted_vehicle_is_longer_than_its_height() -> None:
    """At a tilt of 60 degrees the beam is twice as long as the height."""
    for range_m, problem in ((6.0, ""), (3.0, "by the altimeter 1.5 m: the altimeter is wrong")):
        watch = HeightWatch(VehicleConfig())
        watch.update(at(0.0, 0.0), [Altimeter(t_ns=0)], [])
        for tenth in range(1, 30):
            high = at(0.1 * tenth, 3.0)
            assert high.odometry is not None
            tilted = replace(high.odometry, q_ned_from_frd=quat_from_euler(pi / 3, 0.0, 0.0))
            watch.update(replace(high, odometry=tilted), [Altimeter(t_ns=0, range_m=range_m)], [])
        assert problem in watch.problem and bool(watch.problem) is bool(problem)


def test_the_altimeter_is_not_compared_over_other_ground_nor_above_its_range() -> None:
    assert climbed(3.0, range_m=6.0, barometer_m=3.0, way_m=4.0).problem == ""
    assert "the altimeter is wrong" in climbed(4.0, range_m=6.0, barometer_m=4.0, way_m=2.0).problem
    assert climbed(9.0, range_m=None, barometer_m=9.0).problem == ""
    assert "one of the two is wrong" in climbed(9.0, range_m=None, barometer_m=0.0).problem


def test_it_listens_from_the_arming_to_a_minute_after_the_takeoff() -> None:
    watch = HeightWatch(VehicleConfig())
    heard = []
    for state in (at(0.0, 0.0, armed=False), at(1.0, 0.0), at(30.0, 3.0), at(62.0, 3.0), at(63.0, 0.0, armed=False)):
        watch.update(state, [], [])
        heard.append(watch.listens)
    assert heard == [False, True, True, False, False]


def test_a_vehicle_that_was_first_heard_in_the_air_is_not_judged() -> None:
    watch = HeightWatch(VehicleConfig())
    for tenth in range(30):
        watch.update(at(0.1 * tenth, 3.0), [Altimeter(t_ns=0, range_m=0.2)], [])
    assert (watch.problem, watch.listens) == ("", False)


@pytest.mark.parametrize(("later_s", "judged"), [(50.0, True), (70.0, False)])
def test_heights_are_compared_within_the_first_minute_of_a_flight_however_late_it_begins(
    later_s: float, judged: bool
) -> None:
    watch, begin_s = HeightWatch(VehicleConfig()), 3600.0
    watch.update(at(begin_s, 0.0), [Altimeter(t_ns=0)], [])
    watch.update(at(begin_s + 0.1, 1.0), [Altimeter(t_ns=0, range_m=1.0)], [])
    for tenth in range(20):
        watch.update(at(begin_s + later_s + 0.1 * tenth, 3.0), [Altimeter(t_ns=0, range_m=0.2)], [])
    assert bool(watch.problem) is judged
