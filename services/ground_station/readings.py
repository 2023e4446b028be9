"""The instruments: values with their ages, as text, and never a number that is absent, late or not finite."""

from dataclasses import dataclass
from math import degrees, hypot, isfinite

from jezero.frames import altitude_m, euler_from_quat
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.sensors import Altimeter, Gnss
from jezero.schemas.state import Status
from jezero.services.ground_station.words import COMPASS, duration

ABSENT = "–"
LATE_S = 1.0
"""Age from which on a value is grey."""
LOST_S = 10.0
"""Age from which on a value is not shown any more."""


@dataclass(frozen=True)
class Reading:
    """One value of an instrument.

    Attributes:
        label: name of the value.
        text: the value, or `ABSENT`.
        unit: its unit; "" without a value.
        age: its age in words; "" for one that was never there.
        late: whether it is shown in grey.
    """

    label: str
    text: str
    unit: str
    age: str
    late: bool


def reading(label: str, value: float | None, unit: str, age_s: float | None, decimals: int = 1) -> Reading:
    """A reading of a number.

    Args:
        value: None when it is absent.
        age_s: None when it never arrived.
    """
    if value is None or age_s is None or not isfinite(value) or age_s > LOST_S:
        return Reading(label, ABSENT, "", "" if age_s is None else _age(age_s), True)
    text = f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0 makes 0.0 of -0.0
    return Reading(label, text, unit, _age(age_s), age_s > LATE_S)


def _age(age_s: float) -> str:
    return "now" if age_s <= LATE_S else f"{duration(age_s)} ago"


def compass_point(heading_deg: float) -> str:
    """The nearest of eight points of the compass."""
    return COMPASS[2 * round(heading_deg / 45.0) % 16]


def flight_readings(status: Status | None, age_s: float | None, start_z_ned_m: float) -> list[Reading]:
    """Attitude, heights, speeds, battery and position.

    Args:
        status: newest status, with its odometry.
        age_s: age of the status.
        start_z_ned_m: z of the place from which the height is counted.
    """
    odometry = None if status is None else status.odometry
    battery = None if status is None else status.battery
    wind_mps = None if status is None else status.wind_ned_mps
    pos_m = vel_mps = None
    roll_deg = pitch_deg = heading_deg = None
    if odometry is not None:
        pos_m, vel_mps = odometry.pos_uav_ned_m, odometry.vel_uav_ned_mps
        if all(map(isfinite, odometry.q_ned_from_frd)):
            roll_deg, pitch_deg, yaw_deg = (degrees(angle) for angle in euler_from_quat(odometry.q_ned_from_frd))
            heading_deg = yaw_deg % 360.0
    height_m = None if pos_m is None else altitude_m(pos_m[2] - start_z_ned_m)
    remaining = None if battery is None else battery.remaining
    return [
        reading("heading", heading_deg, "°" if heading_deg is None else f"° {compass_point(heading_deg)}", age_s, 0),
        reading("height", height_m, "m", age_s, 2),
        reading("speed", None if vel_mps is None else hypot(vel_mps[0], vel_mps[1]), "m/s", age_s),
        reading("climb", None if vel_mps is None else -vel_mps[2], "m/s", age_s),
        reading("battery", None if remaining is None else 100.0 * remaining, "%", age_s, 0),
        reading("north", None if pos_m is None else pos_m[0], "m", age_s, 2),
        reading("east", None if pos_m is None else pos_m[1], "m", age_s, 2),
        reading("position σ", None if odometry is None else odometry.std_pos_m, "m", age_s, 2),
        reading("roll", roll_deg, "°", age_s),
        reading("pitch", pitch_deg, "°", age_s),
        reading("voltage", None if battery is None else battery.voltage_v, "V", age_s),
        reading("wind", None if wind_mps is None else hypot(wind_mps[0], wind_mps[1]), "m/s", age_s),
    ]


def ground_reading(altimeter: Altimeter | None, age_s: float | None) -> Reading:
    """Height over the ground, by the altimeter."""
    return reading("over ground", None if altimeter is None else altimeter.range_m, "m", age_s, 2)


def gnss_readings(gnss: Gnss | None, age_s: float | None) -> list[Reading]:
    """Quality of the GNSS fix."""
    return [
        reading("satellites", None if gnss is None else gnss.satellites, "", age_s, 0),
        reading("GNSS σ", None if gnss is None else gnss.std_horizontal_m, "m", age_s, 2),
        reading("GNSS σ up", None if gnss is None else gnss.std_vertical_m, "m", age_s, 2),
        reading("GNSS speed", None if gnss is None else hypot(*gnss.vel_uav_ned_mps[:2]), "m/s", age_s),
    ]


def rover_readings(
    relative: Relative | None, relative_age_s: float | None, rover: RoverEstimate | None, rover_age_s: float | None
) -> list[Reading]:
    """Distance to the rover and what the estimate is worth; nothing of an estimate that is invalid."""
    valid = relative if relative is not None and relative.valid else None
    rel_m = None if valid is None else valid.pos_uav_rel_rover_ned_m
    std_m = None if valid is None else max(valid.cov[0], valid.cov[6], 0.0) ** 0.5
    speed_mps = None
    if rover is not None and rover.valid:
        speed_mps = hypot(rover.vel_rover_ned_mps[0], rover.vel_rover_ned_mps[1])
    return [
        reading("to the rover", None if rel_m is None else hypot(rel_m[0], rel_m[1]), "m", relative_age_s, 2),
        reading("over rover", None if rel_m is None else altitude_m(rel_m[2]), "m", relative_age_s, 2),
        reading("estimate 3σ", None if std_m is None else 3.0 * std_m, "m", relative_age_s, 2),
        reading("rover speed", speed_mps, "m/s", rover_age_s),
    ]
