"""Sensors whose readings are published on the bus, with their garbled and their wrong readings."""

from collections.abc import Callable
from random import Random
from typing import Any, NamedTuple

from msgspec.structs import replace

from jezero.schemas import sensors as messages
from jezero.schemas import topics
from jezero.schemas.rows import Topic


class BusSensor(NamedTuple):
    """One sensor.

    Attributes:
        topic: topic of its readings.
        garbled: returns a random reading from a reading.
        wrong: returns a reading with a constant error from a reading and the error's amount, 0 to 1.
    """

    topic: Topic[Any]
    garbled: Callable[[Any, Random], Any]
    wrong: Callable[[Any, float], Any]


def _garbled_altimeter(reading: messages.Altimeter, rng: Random) -> messages.Altimeter:
    return replace(reading, range_m=rng.choice((None, 0.0, rng.uniform(0.0, 10.0), rng.uniform(0.0, 1e6))))


def _wrong_altimeter(reading: messages.Altimeter, amount: float) -> messages.Altimeter:
    return reading if reading.range_m is None else replace(reading, range_m=reading.range_m + amount)


def _garbled_uwb(reading: messages.Uwb, rng: Random) -> messages.Uwb:
    return replace(reading, ranges=tuple(replace(r, range_m=rng.uniform(0.0, 1e3)) for r in reading.ranges))


def _wrong_uwb(reading: messages.Uwb, amount: float) -> messages.Uwb:
    return replace(reading, ranges=tuple(replace(r, range_m=r.range_m + amount) for r in reading.ranges))


def _garbled_rover_odometry(reading: messages.RoverOdometry, rng: Random) -> messages.RoverOdometry:
    return replace(reading, yaw_rover_rad=rng.uniform(-6.0, 6.0), speed_rover_body_mps=rng.uniform(-100.0, 100.0))


def _wrong_rover_odometry(reading: messages.RoverOdometry, amount: float) -> messages.RoverOdometry:
    return replace(reading, speed_rover_body_mps=reading.speed_rover_body_mps + amount)


BUS_SENSORS: dict[str, BusSensor] = {
    "altimeter": BusSensor(topics.ALTIMETER, _garbled_altimeter, _wrong_altimeter),
    "uwb": BusSensor(topics.UWB, _garbled_uwb, _wrong_uwb),
    "rover_odometry": BusSensor(topics.ROVER_ODOMETRY, _garbled_rover_odometry, _wrong_rover_odometry),
}
