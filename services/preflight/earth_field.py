"""The Earth's magnetic field at a place, by the tables of pymavlink, which ArduPilot's autopilots use."""

from math import radians
from typing import NamedTuple

from jezero.base.frames import Vec3


class EarthField(NamedTuple):
    """The field at one place.

    Attributes:
        strength_gauss: its strength.
        dip_rad: angle by which the field points down, below the horizon.
    """

    strength_gauss: float
    dip_rad: float


def earth_field(position_deg: Vec3) -> EarthField | None:
    """The field at a place; None where the tables end, near the poles."""
    from pymavlink.mavextra import get_mag_field_ef  # it takes longer to import than the rest of the service

    latitude_deg, longitude_deg, _ = position_deg
    found = get_mag_field_ef(latitude_deg, longitude_deg)
    if found is None:
        return None
    _, inclination_deg, strength_gauss = found
    return EarthField(strength_gauss, radians(inclination_deg))
