"""The checks of sensors, noise, position and compasses: each verdict with its words."""

from math import cos, pi, radians, sin
from typing import Any

import msgspec
import pytest

from jezero.base.frames import geodetic_from_ned
from jezero.schemas.estimate import SetParameters
from jezero.schemas.rows import Topic
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ALTIMETER, BARO, ESTIMATE_TAG, GNSS, IMU, MAG, ROVER_ODOMETRY, STATUS, UWB
from jezero.services.preflight.sensor_checks import (
    check_compass,
    check_gnss,
    check_noise,
    check_rover,
    check_sensors,
)
from tests.services.preflight.healthy import (
    HEARD,
    ORIGIN_DEG,
    altimeter,
    baro,
    gnss,
    imu,
    mag,
    readings,
    rover,
    status,
    tags,
    uwb,
)

ONE_LOUD_ANCHOR = tuple(
    msgspec.structs.replace(quiet, ranges=(*quiet.ranges[:-1], loud.ranges[-1]))
    for quiet, loud in zip(uwb(), uwb(std_m=0.5), strict=True)
)


@pytest.mark.parametrize(
    ("topic", "messages", "verdict", "words"),
    [
        (MAG, (), "failed", "the magnetometer has fallen silent"),
        (UWB, (), "warning", "the UWB has fallen silent"),
        (GNSS, gnss()[:5], "failed", "readings of the GNSS are 0.6 s old, 0.5 s is the limit"),
        (IMU, imu()[::3], "warning", "IMU sends 17 instead of 50 readings a second"),
    ],
)
def test_a_silent_or_late_sensor_fails_and_a_slow_one_or_one_of_the_landing_warns(
    topic: Topic[Any], messages: tuple[Any, ...], verdict: str, words: str
) -> None:
    outcome = check_sensors(readings({topic.name: messages}))
    assert outcome.verdict == verdict
    assert words in outcome.text


def test_of_healthy_sensors_the_age_of_the_oldest_reading_is_said() -> None:
    outcome = check_sensors(readings({GNSS.name: gnss()[:8]}))
    assert (outcome.verdict, outcome.text) == ("passed", "all 7 send, the oldest reading is 300 ms old")


def test_a_sensor_that_has_never_been_heard_warns() -> None:
    outcome = check_sensors(readings({UWB.name: ()}, heard=HEARD - {UWB.name}))
    assert (outcome.verdict, outcome.text) == ("warning", "no readings of UWB so far")


@pytest.mark.parametrize(
    ("topic", "messages", "verdict", "words"),
    [
        (IMU, imu(std_gyro_rps=0.03), "warning", "gyro 0.027 rad/s, at most 0.02 is normal"),
        (IMU, imu(std_gyro_rps=0.07), "warning", "is the vehicle shaken, or a sensor loose?"),
        (IMU, imu(std_gyro_rps=0.11), "failed", "is the vehicle shaken, or a sensor loose?"),
        (IMU, imu(std_gyro_rps=0.2), "failed", "is the vehicle shaken, or a sensor loose?"),
        (IMU, imu(std_acc_mps2=0.3), "warning", "m/s², at most 0.2 is normal"),
        (ALTIMETER, altimeter(std_m=0.12), "warning", "altimeter 0.1"),
        (UWB, uwb(std_m=0.5), "failed", "UWB 0."),
        (UWB, uwb(speed_rover_mps=0.5), "passed", "UWB 0.0"),
        (UWB, uwb(outliers_m=5.0), "passed", "UWB 0.0"),
        (UWB, ONE_LOUD_ANCHOR, "failed", "UWB 0."),
        (IMU, (imu()[0],) * 50, "failed", "the IMU repeats one reading to the last digit"),
        (MAG, (mag()[0],) * 10, "failed", "the magnetometer repeats one reading"),
    ],
)
def test_noise_warns_above_twice_and_fails_above_eight_times_what_is_expected(
    topic: Topic[Any], messages: tuple[Any, ...], verdict: str, words: str
) -> None:
    outcome = check_noise(readings({topic.name: messages}))
    assert outcome.verdict == verdict, outcome.text
    assert words in outcome.text


@pytest.mark.parametrize("topic", [IMU, ALTIMETER, UWB])
def test_the_noise_of_a_few_readings_and_of_a_sensor_without_a_known_noise_is_not_judged(topic: Topic[Any]) -> None:
    loud = {IMU: imu(std_acc_mps2=9.0), ALTIMETER: altimeter(std_m=9.0), UWB: uwb(std_m=9.0)}[topic]
    assert check_noise(readings({topic.name: loud})).verdict == "failed"
    assert check_noise(readings({topic.name: loud[:3]})).verdict == "passed"
    if topic is not IMU:
        unknown = SetParameters(std_altimeter_m=0.0, std_uwb_m=0.0)
        assert check_noise(readings({topic.name: loud}, parameters=unknown)).verdict == "passed"


def test_without_readings_the_noise_is_not_called_normal() -> None:
    outcome = check_noise(readings({topic.name: () for topic in (IMU, ALTIMETER, UWB)}))
    assert (outcome.verdict, outcome.text) == ("warning", "too few readings to measure it")


def test_a_barometer_that_repeats_one_reading_fails() -> None:
    check = check_noise(readings({BARO.name: baro(std_pa=0.0)}))
    assert check.verdict == "failed" and "the barometer repeats one reading" in check.text


def test_an_altimeter_that_measures_metres_below_a_standing_vehicle_fails() -> None:
    far = tuple(msgspec.structs.replace(reading, range_m=5.0) for reading in altimeter())
    check = check_sensors(readings({ALTIMETER.name: far}))
    assert check.verdict == "failed" and "the altimeter reads 5.0 m while the vehicle stands" in check.text
    flying = status(armed=True, landed=False, code=StatusCode.HOVER)
    for moves in (flying, status(armed=True), status(landed=False)):
        assert check_sensors(readings({ALTIMETER.name: far, STATUS.name: (moves,)})).verdict == "passed"


@pytest.mark.parametrize(("range_m", "verdict"), [(0.7, "passed"), (0.9, "failed")])
def test_an_altimeter_may_look_past_a_stone_below_a_standing_vehicle(range_m: float, verdict: str) -> None:
    near = tuple(msgspec.structs.replace(reading, range_m=range_m) for reading in altimeter())
    assert check_sensors(readings({ALTIMETER.name: near})).verdict == verdict


def test_a_sensor_that_sends_more_than_half_of_its_readings_is_not_slow() -> None:
    assert check_sensors(readings({IMU.name: imu()[::2]})).verdict == "passed"


def test_one_very_noisy_sensor_among_noisy_ones_fails() -> None:
    outcome = check_noise(readings({IMU.name: imu(std_acc_mps2=0.3, std_gyro_rps=0.2)}))
    assert outcome.verdict == "failed"


def test_the_noise_of_a_flying_vehicle_is_not_judged() -> None:
    flying = status(code=int(StatusCode.HOVER))
    outcome = check_noise(readings({STATUS.name: (flying,), IMU.name: imu(std_acc_mps2=3.0)}))
    assert (outcome.verdict, outcome.text) == ("passed", "it is measured only while the vehicle stands")


@pytest.mark.parametrize(
    ("north_m", "verdict"),
    [(2.9, "passed"), (3.1, "warning"), (7.9, "warning"), (8.1, "failed")],
)
def test_the_estimate_may_be_three_standard_deviations_and_a_margin_from_the_fixes(
    north_m: float, verdict: str
) -> None:
    """The standard deviation of fixes and estimate is 0.5 m, the margin 1.5 m."""
    here = status()
    assert here.odometry is not None
    moved = msgspec.structs.replace(here.odometry, pos_uav_ned_m=(north_m, 0.0, 0.0))
    outcome = check_gnss(readings({STATUS.name: (status(odometry=moved),)}))
    assert outcome.verdict == verdict, outcome.text
    assert f"{north_m:.1f} m from the fixes, whose standard deviation is 0.5 m; 14 satellites" in outcome.text


@pytest.mark.parametrize(("north_m", "east_m"), [(12.0, 0.0), (0.0, 12.0)])
def test_fixes_that_have_moved_away_from_the_estimate_fail_and_those_that_moved_with_it_pass(
    north_m: float, east_m: float
) -> None:
    here = status().odometry
    assert here is not None
    position_deg = geodetic_from_ned((north_m, east_m, 0.0), ORIGIN_DEG)
    fixes = tuple(msgspec.structs.replace(fix, position_deg=position_deg) for fix in gnss())
    apart = check_gnss(readings({GNSS.name: fixes}))
    assert apart.verdict == "failed" and "the estimate is 12.0 m from the fixes" in apart.text
    moved = status(odometry=msgspec.structs.replace(here, pos_uav_ned_m=(north_m, east_m, 0.0)))
    assert check_gnss(readings({GNSS.name: fixes, STATUS.name: (moved,)})).verdict == "passed"


@pytest.mark.parametrize(("satellites", "verdict"), [(5, "warning"), (6, "passed")])
def test_few_satellites_in_the_newest_fix_warn(satellites: int, verdict: str) -> None:
    outcome = check_gnss(readings({GNSS.name: (*gnss()[:-1], gnss(satellites=satellites)[-1])}))
    assert outcome.verdict == verdict
    assert f"; {satellites} satellites" in outcome.text


@pytest.mark.parametrize(("east_m", "verdict"), [(7.4, "passed"), (11.9, "warning"), (12.1, "failed")])
def test_an_uncertain_position_may_be_farther_from_the_fixes(east_m: float, verdict: str) -> None:
    """Three standard deviations of 2 m and 1.5 m are normal, and six are too much."""
    here = status().odometry
    assert here is not None
    moved = msgspec.structs.replace(here, pos_uav_ned_m=(0.0, east_m, 0.0), std_pos_m=0.0)
    fixes = (*gnss()[:-1], msgspec.structs.replace(gnss()[-1], std_horizontal_m=2.0))
    outcome = check_gnss(readings({STATUS.name: (status(odometry=moved),), GNSS.name: fixes}))
    assert outcome.verdict == verdict, outcome.text


def test_without_a_position_or_an_origin_the_fixes_are_compared_with_nothing() -> None:
    here = status().odometry
    assert here is not None
    for odometry in (None, msgspec.structs.replace(here, origin_deg=None)):
        outcome = check_gnss(readings({STATUS.name: (status(odometry=odometry),)}))
        assert (outcome.verdict, outcome.text[:33]) == ("warning", "the autopilot has no position yet")
        assert check_compass(readings({STATUS.name: (status(odometry=odometry),)})).verdict != "failed"


def test_the_standard_deviation_of_the_estimate_counts_as_that_of_the_fixes() -> None:
    """Together they are 2.04 m, of which three and the margin of 1.5 m are 7.6 m."""
    here = status().odometry
    assert here is not None
    for east_m, verdict in ((7.0, "passed"), (8.2, "warning")):
        moved = msgspec.structs.replace(here, pos_uav_ned_m=(0.0, east_m, 0.0), std_pos_m=2.0)
        outcome = check_gnss(readings({STATUS.name: (status(odometry=moved),)}))
        assert outcome.verdict == verdict and "whose standard deviation is 2.0 m" in outcome.text


def test_where_the_earths_field_is_not_known_only_its_direction_is_compared() -> None:
    here = status().odometry
    assert here is not None
    at_pole = status(odometry=msgspec.structs.replace(here, origin_deg=(90.0, 0.0, 0.0)))
    assert check_compass(readings({STATUS.name: (at_pole,)})).verdict == "passed"


@pytest.mark.parametrize(
    ("error_deg", "verdict"), [(-19.0, "passed"), (21.0, "warning"), (59.0, "warning"), (-62.0, "failed")]
)
def test_the_heading_may_be_20_degrees_from_magnetic_north(error_deg: float, verdict: str) -> None:
    outcome = check_compass(readings({MAG.name: mag(error_rad=radians(error_deg), std_gauss=0.0)}))
    assert outcome.verdict == verdict
    assert f"heading is 29°, magnetic north lies {abs(error_deg):.0f}° from its north" in outcome.text
    assert outcome.text.endswith("check how it is mounted") is (verdict != "passed")


@pytest.mark.parametrize(
    ("field_gauss", "words"),
    [
        ((0.216, 0.0, 0.43), ""),
        ((0.3, 0.0, 0.6), "the field has 0.67 gauss and points 63° down, at this place it is 0.48 gauss and 63°"),
        ((0.216, 0.0, -0.43), "points -63° down"),
        ((0.43, 0.0, 0.216), "points 27° down"),
        ((0.276, 0.0, 0.394), ""),  # 55° down
        ((0.303, 0.0, 0.374), "points 51° down, at this place it is 0.48 gauss and 63°"),
        ((0.157, 0.0, 0.455), ""),  # 71° down
        ((0.125, 0.0, 0.465), "points 75° down"),
    ],
)
def test_a_field_that_is_not_the_earths_at_this_place_warns(field_gauss: tuple[float, ...], words: str) -> None:
    x, _, z = field_gauss
    readings_of_mag = tuple(
        msgspec.structs.replace(each, field_frd_gauss=(x * cos(-0.5), x * sin(-0.5), z)) for each in mag()
    )
    check = check_compass(readings({MAG.name: readings_of_mag}))
    assert check.verdict == ("warning" if words else "passed")
    assert words in check.text


def test_the_rovers_compass_is_compared_with_the_tags_across_south() -> None:
    near = {ROVER_ODOMETRY.name: rover(pi - 0.05), ESTIMATE_TAG.name: tags(-pi + 0.05)}
    assert check_rover(readings(near)).verdict == "passed"
    apart = {ROVER_ODOMETRY.name: rover(0.5), ESTIMATE_TAG.name: tags(0.7)}
    outcome = check_rover(readings(apart))
    assert outcome.verdict == "warning"
    assert "29°, the tags on it 40° by the vehicle's compass: one of the two compasses is wrong" in outcome.text


def test_a_rover_without_tags_in_view_or_without_odometry_never_fails() -> None:
    assert "no tag is in view" in check_rover(readings({ESTIMATE_TAG.name: ()})).text
    assert "no tag is in view" in check_rover(readings({ESTIMATE_TAG.name: tags(None)})).text
    silent = check_rover(readings({ROVER_ODOMETRY.name: ()}))
    assert (silent.verdict, silent.text[:29]) == ("warning", "the rover sends no odometry: ")


@pytest.mark.parametrize(
    ("error_deg", "verdict"), [(0.0, "passed"), (-8.0, "passed"), (15.0, "warning"), (70.0, "failed")]
)
def test_without_a_magnetometer_the_heading_is_compared_with_that_of_the_gnss_receiver(
    error_deg: float, verdict: str
) -> None:
    fixes = tuple(msgspec.structs.replace(fix, yaw_uav_rad=0.5 + radians(error_deg)) for fix in gnss())
    found = readings({GNSS.name: fixes, MAG.name: ()}, heading_by="gnss")
    outcome = check_compass(found)
    assert outcome.verdict == verdict
    assert f"heading is 29°, {abs(error_deg):.0f}° from that of the GNSS receiver's two antennas" in outcome.text
    assert outcome.text.endswith("check how the antennas are mounted") is (verdict != "passed")
    assert check_sensors(found).verdict == "passed"


def test_a_receiver_without_a_heading_is_a_warning_where_nothing_else_measures_it() -> None:
    check = check_compass(readings(heading_by="gnss"))
    assert check.verdict == "warning" and check.text.startswith("no heading of the GNSS receiver, or of the autopilot")
