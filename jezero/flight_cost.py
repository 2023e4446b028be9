"""What a flight takes in the wind: its time, and the charge of the battery."""

from math import hypot
from typing import NamedTuple

from jezero.frames import Vec3, subtract
from jezero.vehicle_config import VehicleConfig


class FlightCost(NamedTuple):
    """Time of a flight, and what the flight takes from the battery.

    Attributes:
        time_s: of the flight.
        hover_s: time in hover, in still air, that uses the same charge.
    """

    time_s: float
    hover_s: float

    def plus(self, other: "FlightCost") -> "FlightCost":
        """Both flights, one after the other."""
        return FlightCost(self.time_s + other.time_s, self.hover_s + other.hover_s)


def flight_cost(time_s: float, vel_ned_mps: Vec3, wind_ned_mps: Vec3, vehicle: VehicleConfig) -> FlightCost:
    """Cost of a steady flight, or of a hover in the wind.

    Args:
        vel_ned_mps: velocity over ground.
    """
    battery, (north_mps, east_mps, _) = vehicle.battery, subtract(vel_ned_mps, wind_ned_mps)
    hover_a = battery.electronics_a + battery.hover_a
    flight_a = battery.electronics_a + battery.hover_a * vehicle.airframe.power_ratio(hypot(north_mps, east_mps))
    return FlightCost(time_s, time_s * flight_a / hover_a if hover_a > 0.0 else time_s)
