"""The preflight checks of the sensors: ages, noise, and whether they agree with each other.

Each check is a function from the readings of one round to a `Check`.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import atan2, cos, degrees, hypot, sin
from statistics import median, stdev
from typing import Any, NamedTuple

from msgspec import UNSET

from jezero.base.frames import Vec3, horizontal, ned_from_geodetic, quat_rotate, subtract, wrap_pi, yaw_from_quat
from jezero.schemas.preflight import Check, CheckName, Verdict
from jezero.schemas.rows import Topic
from jezero.schemas.state import Odometry, StatusCode
from jezero.schemas.struct import TEXT_MAX
from jezero.schemas.topics import ALTIMETER, BARO, ESTIMATE_TAG, GNSS, IMU, MAG, ROVER_ODOMETRY, UWB
from jezero.services.preflight.earth_field import earth_field
from jezero.services.preflight.readings import Readings

NEEDED: tuple[Topic[Any], ...] = (IMU, GNSS, BARO, MAG, ALTIMETER)
"""Sensors of the vehicle itself; those after them are needed for landings on the rover only."""
ROVER_SENSORS: tuple[Topic[Any], ...] = (UWB, ROVER_ODOMETRY)
WORDS = {
    IMU.name: "IMU", GNSS.name: "GNSS", BARO.name: "barometer", MAG.name: "magnetometer",
    ALTIMETER.name: "altimeter", UWB.name: "UWB", ROVER_ODOMETRY.name: "rover odometry",
}  # fmt: skip
AGE_MAX_S = 0.5
DURATION_MIN_S = 0.1
RATE_MIN = 0.5
"""A sensor that sends less than this part of its readings is worth knowing."""
STD_ACC_MPS2, STD_GYRO_RPS = 0.1, 0.01
"""Usual noise of a small IMU on a vehicle that stands still with its motors off."""
NOISE_WARN, NOISE_MAX = 2.0, 8.0
"""Factors above the expected standard deviation at which noise is a warning, and a failure."""
NOISE_READINGS_MIN = 8
STD_PER_DIFFERENCE = 1.048
"""Standard deviation of normally distributed readings, over the median distance of two of them."""
GNSS_SIGMAS, GNSS_MARGIN_M, GNSS_MAX_M = 3.0, 1.5, 8.0
"""Distance of estimate and GNSS that is a warning, with its margin, and the one that is a failure."""
SATELLITES_MIN = 6
HEADING_WARN_RAD, HEADING_MAX_RAD = 0.35, 1.05
"""20 and 60 degrees: the angle between magnetic and true north, up to 20 degrees in inhabited places, is in it."""
ROVER_HEADING_WARN_RAD = 0.17
GNSS_HEADING_WARN_RAD = 0.17
STRENGTH_SHARE_MAX, DIP_MAX_RAD = 0.2, 0.17
"""Differences of the magnetic field from the Earth's at the place: a compass near iron, or one that is mounted on its
side. The tables of the Earth's field are good to some percent and one or two degrees."""
STANDING_RANGE_MAX_M = 0.8
"""Greatest range of the altimeter of a vehicle that stands; the beam may miss the platform's edge or a stone."""


def check_sensors(readings: Readings) -> Check:
    """Whether every sensor sends, in time and often enough."""
    needed = [topic for topic in NEEDED if topic is not MAG or readings.heading_by == "magnetometer"]
    failed, warned = list(_silent(readings, needed)), list(_silent(readings, ROVER_SENSORS))
    failed += [*_altimeter_too_high(readings), *([readings.height_problem] if readings.height_problem else [])]
    never = [WORDS[t.name] for t in (*needed, *ROVER_SENSORS) if not readings.all(t) and t.name not in readings.heard]
    if never:
        warned.append(f"no readings of {', '.join(never)} so far")
    for topic in (*needed, *ROVER_SENSORS):
        rate_hz = len(readings.all(topic)) / max(readings.duration_s, DURATION_MIN_S)
        if readings.all(topic) and topic.rate_hz is not None and rate_hz < RATE_MIN * topic.rate_hz:
            warned.append(f"{WORDS[topic.name]} sends {rate_hz:.0f} instead of {topic.rate_hz:g} readings a second")
    if failed or warned:
        return _check("sensors", "failed" if failed else "warning", "; ".join([*failed, *warned]))
    ages = [age_s for topic in (*needed, *ROVER_SENSORS) if (age_s := readings.age_s(topic)) is not None]
    return _check("sensors", "passed", f"all {len(ages)} send, the oldest reading is {1000.0 * max(ages):.0f} ms old")


def _silent(readings: Readings, topics: Sequence[Topic[Any]]) -> Iterator[str]:
    """Sensors of these that have fallen silent, or whose readings are old."""
    for topic in topics:
        age_s = readings.age_s(topic)
        if age_s is None and topic.name in readings.heard:
            yield f"the {WORDS[topic.name]} has fallen silent"
        elif age_s is not None and age_s > AGE_MAX_S:
            yield f"readings of the {WORDS[topic.name]} are {age_s:.1f} s old, {AGE_MAX_S:g} s is the limit"


def _altimeter_too_high(readings: Readings) -> list[str]:
    """The problem of an altimeter that measures a distance from a vehicle that stands."""
    ranges = [m.range_m for m in readings.all(ALTIMETER) if m.range_m is not None]
    stands = readings.status is not None and readings.status.landed and not readings.status.armed
    if not ranges or not stands or (range_m := median(ranges)) < STANDING_RANGE_MAX_M:
        return []
    return [
        f"the altimeter reads {range_m:.1f} m while the vehicle stands: is something wrong with it, or its mounting?"
    ]


def check_noise(readings: Readings) -> Check:
    """Whether the readings of the standing vehicle scatter as their expected standard deviation says."""
    if readings.status is not None and readings.status.code != StatusCode.IDLE:
        return _check("noise", "passed", "it is measured only while the vehicle stands")
    if frozen := list(_frozen(readings)):
        return _check("noise", "failed", f"{' and '.join(frozen)} repeats one reading to the last digit: restart it")
    noises = list(_noises(readings))
    if not noises:
        return _check("noise", "warning", "too few readings to measure it")
    high = [noise for noise in noises if noise.factor > NOISE_WARN]
    if not high:
        return _check("noise", "passed", ", ".join(f"{noise.name} {noise.std:.2g} {noise.unit}" for noise in noises))
    parts = [f"{n.name} {n.std:.2g} {n.unit}, at most {NOISE_WARN * n.expected:.2g} is normal" for n in high]
    verdict: Verdict = "failed" if max(noise.factor for noise in high) > NOISE_MAX else "warning"
    return _check("noise", verdict, f"{'; '.join(parts)}: is the vehicle shaken, or a sensor loose?")


class _Noise(NamedTuple):
    """Measured and expected standard deviation of one sensor."""

    name: str
    std: float
    expected: float
    unit: str

    @property
    def factor(self) -> float:
        return self.std / self.expected


def _noises(readings: Readings) -> Iterator[_Noise]:
    """Noise of each sensor with enough readings."""
    imu, parameters = readings.all(IMU), readings.parameters
    if len(imu) >= NOISE_READINGS_MIN:
        std_acc = max(stdev(m.acc_imu_frd_mps2[i] for m in imu) for i in range(3))
        std_gyro = max(stdev(m.gyro_imu_frd_rps[i] for m in imu) for i in range(3))
        yield _Noise("accelerometer", std_acc, STD_ACC_MPS2, "m/s²")
        yield _Noise("gyro", std_gyro, STD_GYRO_RPS, "rad/s")
    if parameters is None:
        return
    ranges = [m.range_m for m in readings.all(ALTIMETER) if m.range_m is not None]
    if len(ranges) >= NOISE_READINGS_MIN and parameters.std_altimeter_m:
        yield _Noise("altimeter", _std_of_ranges(ranges), parameters.std_altimeter_m, "m")
    by_anchor: dict[int, list[float]] = {}
    for each in (r for m in readings.all(UWB) for r in m.ranges):
        by_anchor.setdefault(each.anchor, []).append(each.range_m)
    stds = [_std_of_ranges(found) for found in by_anchor.values() if len(found) >= NOISE_READINGS_MIN]
    if stds and parameters.std_uwb_m:
        yield _Noise("UWB", max(stds), parameters.std_uwb_m, "m")


def _std_of_ranges(ranges_m: Sequence[float]) -> float:
    """Standard deviation of ranges by their differences, which a driving rover and a rare outlier leave small."""
    return STD_PER_DIFFERENCE * median(abs(b - a) for a, b in pairwise(ranges_m))


def _frozen(readings: Readings) -> Iterator[str]:
    imu = {(m.acc_imu_frd_mps2, m.gyro_imu_frd_rps) for m in readings.all(IMU)}
    if len(imu) == 1 and len(readings.all(IMU)) >= NOISE_READINGS_MIN:
        yield "the IMU"
    pressures = {m.pressure_pa for m in readings.all(BARO)}
    if len(pressures) == 1 and len(readings.all(BARO)) >= NOISE_READINGS_MIN:
        yield "the barometer"
    fields = {m.field_frd_gauss for m in readings.all(MAG)}
    if len(fields) == 1 and len(readings.all(MAG)) >= NOISE_READINGS_MIN:
        yield "the magnetometer"


def check_gnss(readings: Readings) -> Check:
    """Whether the autopilot's position agrees with the GNSS receiver's."""
    fixes, status = readings.all(GNSS), readings.status
    odometry = None if status is None else status.odometry
    if not fixes:
        return _check("gnss", "warning", "no fix to compare the autopilot's position with")
    if odometry is None or odometry.origin_deg is None:
        return _check("gnss", "warning", "the autopilot has no position yet to compare the fixes with")
    places = [ned_from_geodetic(fix.position_deg, odometry.origin_deg) for fix in fixes]
    mean = tuple(sum(place[i] for place in places) / len(places) for i in range(3))
    apart_m = horizontal(subtract((mean[0], mean[1], mean[2]), odometry.pos_uav_ned_m))
    std_m = hypot(fixes[-1].std_horizontal_m, odometry.std_pos_m or 0.0)
    satellites = fixes[-1].satellites
    text = f"the estimate is {apart_m:.1f} m from the fixes, whose standard deviation is {std_m:.1f} m"
    text += f"; {satellites} satellites"
    if apart_m > max(GNSS_MAX_M, 2.0 * GNSS_SIGMAS * std_m):
        return _check("gnss", "failed", f"{text}: wait until they agree, or restart the autopilot")
    far = apart_m > GNSS_SIGMAS * std_m + GNSS_MARGIN_M
    return _check("gnss", "warning" if far or satellites < SATELLITES_MIN else "passed", text)


def check_compass(readings: Readings) -> Check:
    """Whether the autopilot's heading agrees with the magnetic field, and the last flight with both."""
    if readings.compass_problem:
        return _check("compass", "failed", readings.compass_problem)
    fields, status = readings.all(MAG), readings.status
    odometry = None if status is None else status.odometry
    if readings.heading_by == "gnss":
        return _check_gnss_heading(readings, odometry)
    if not fields or odometry is None:
        return _check("compass", "warning", "no magnetometer or no heading to compare")
    level = [quat_rotate(odometry.q_ned_from_frd, m.field_frd_gauss) for m in fields]
    # Level axes by the autopilot's own attitude: magnetic north lies at its error of heading, plus the declination.
    apart_rad = atan2(sum(v[1] for v in level), sum(v[0] for v in level))
    heading_deg = degrees(yaw_from_quat(odometry.q_ned_from_frd)) % 360.0
    apart_deg = abs(degrees(apart_rad))
    text = f"the autopilot's heading is {heading_deg:.0f}°, magnetic north lies {apart_deg:.0f}° from its north"
    failed, warned = abs(apart_rad) > HEADING_MAX_RAD, abs(apart_rad) > HEADING_WARN_RAD
    if unlike := _unlike_earth(level, odometry.origin_deg):
        text, warned = f"{text}; {unlike}", True
    advice = ": keep metal away, calibrate it, and check how it is mounted" if warned else ""
    return _check("compass", "failed" if failed else "warning" if warned else "passed", text + advice)


def _check_gnss_heading(readings: Readings, odometry: Odometry | None) -> Check:
    """Whether the autopilot's heading agrees with the GNSS receiver's, of a vehicle without a magnetometer."""
    yaws_rad = [fix.yaw_uav_rad for fix in readings.all(GNSS) if fix.yaw_uav_rad is not UNSET]
    if not yaws_rad or odometry is None:
        return _check("compass", "warning", "no heading of the GNSS receiver, or of the autopilot, to compare")
    heading_rad = yaw_from_quat(odometry.q_ned_from_frd)
    apart_rad = abs(wrap_pi(_mean_angle(yaws_rad) - heading_rad))
    text = (
        f"the autopilot's heading is {degrees(heading_rad) % 360.0:.0f}°, {degrees(apart_rad):.0f}° from that of the "
    )
    text += "GNSS receiver's two antennas; there is no magnetometer"
    failed, warned = apart_rad > HEADING_MAX_RAD, apart_rad > GNSS_HEADING_WARN_RAD
    advice = ": check how the antennas are mounted" if warned else ""
    return _check("compass", "failed" if failed else "warning" if warned else "passed", text + advice)


def _unlike_earth(fields_ned_gauss: Sequence[Vec3], position_deg: Vec3 | None) -> str:
    """How the measured field differs from the Earth's at this place, or ""; it is known whatever the heading is."""
    earth = None if position_deg is None else earth_field(position_deg)
    if earth is None:
        return ""
    north, east, down = (sum(field[axis] for field in fields_ned_gauss) / len(fields_ned_gauss) for axis in range(3))
    strength_gauss, dip_rad = hypot(north, east, down), atan2(down, hypot(north, east))
    strong = abs(strength_gauss / earth.strength_gauss - 1.0) > STRENGTH_SHARE_MAX
    if not strong and abs(dip_rad - earth.dip_rad) < DIP_MAX_RAD:
        return ""
    return (
        f"the field has {strength_gauss:.2f} gauss and points {degrees(dip_rad):.0f}° down, at this place it is "
        f"{earth.strength_gauss:.2f} gauss and {degrees(earth.dip_rad):.0f}°"
    )


def check_rover(readings: Readings) -> Check:
    """Whether the rover's compass agrees with its heading by the tags; only a warning, as the vehicle flies without."""
    rover = readings.all(ROVER_ODOMETRY)
    if not rover:
        return _check("rover", "warning", "the rover sends no odometry: a landing on it has to do without")
    heading_rad = _mean_angle([m.yaw_rover_rad for m in rover])
    seen = [tag.yaw_rover_rad for tag in readings.all(ESTIMATE_TAG) if tag.yaw_rover_rad is not None]
    text = f"its compass says {degrees(heading_rad) % 360.0:.0f}°"
    if not seen:
        return _check("rover", "passed", f"{text}; no tag is in view, so nothing contradicts it")
    by_tags_rad = _mean_angle(seen)
    text += f", the tags on it {degrees(by_tags_rad) % 360.0:.0f}° by the vehicle's compass"
    apart_rad = wrap_pi(heading_rad - by_tags_rad)
    if abs(apart_rad) > ROVER_HEADING_WARN_RAD:
        return _check("rover", "warning", f"{text}: one of the two compasses is wrong")
    return _check("rover", "passed", text)


def _mean_angle(angles_rad: Sequence[float]) -> float:
    return atan2(sum(sin(a) for a in angles_rad), sum(cos(a) for a in angles_rad))


def _check(name: CheckName, verdict: Verdict, text: str) -> Check:
    return Check(name=name, verdict=verdict, text=text[:TEXT_MAX])
