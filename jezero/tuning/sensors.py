"""The sensors whose innovations are judged: names, units, and the settings of their noise."""

from math import degrees
from typing import NamedTuple

import msgspec

from jezero.services.estimator.config import Tuning
from jezero.services.estimator.innovations import Sensor


class SensorInfo(NamedTuple):
    """How a sensor is shown.

    Attributes:
        label: name for people.
        unit: unit in which innovations are shown.
        per_si: number of these units in m, m/s, rad or rad/s.
        setting: setting in `[tuning]` of estimator.toml that scales the noise, and that the sensor determines; "" for
            none.
    """

    label: str
    unit: str
    per_si: float
    setting: str = ""


SENSORS: dict[Sensor, SensorInfo] = {
    "uwb": SensorInfo("UWB ranges", "cm", 100.0, "std_uwb_m"),
    "tag": SensorInfo("tag, position", "cm", 100.0, "scale_std_tag"),
    "tag_yaw": SensorInfo("tag, heading", "°", degrees(1.0)),
    "altimeter": SensorInfo("altimeter", "cm", 100.0, "std_altimeter_m"),
    "rover_yaw": SensorInfo("rover, yaw", "°", degrees(1.0), "std_yaw_rover_rad"),
    "rover_yaw_rate": SensorInfo("rover, yaw rate", "°/s", degrees(1.0), "std_yaw_rate_rover_rps"),
    "rover_speed": SensorInfo("rover, speed", "cm/s", 100.0),
    "autopilot_position": SensorInfo("autopilot, position", "cm", 100.0),
    "autopilot_velocity": SensorInfo("autopilot, velocity", "cm/s", 100.0),
}
"""All sensors, in the order in which they are shown."""


def limits(setting: str) -> tuple[float, float]:
    """Least and greatest value of a setting of `[tuning]`."""
    info = msgspec.inspect.type_info(Tuning)
    assert isinstance(info, msgspec.inspect.StructType)
    kind = next(field.type for field in info.fields if field.name == setting)
    assert isinstance(kind, msgspec.inspect.FloatType)
    assert kind.ge is not None and kind.le is not None
    return kind.ge, kind.le
