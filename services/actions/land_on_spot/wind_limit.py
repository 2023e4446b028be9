"""The limit of the wind in which a landing starts, and in which its approach goes on."""

from math import hypot

from jezero.frames import Vec3
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import VehicleState

ABOVE_LIMIT_S = 3.0
"""A wind that is above the limit for a shorter time is a gust, in which the vehicle waits over the platform."""


class WindLimit:
    """Compares the estimated mean wind with the limit while a landing is flown.

    Args:
        max_mps: the limit.
        force: the goal is flown in any wind.

    Attributes:
        reason: reason to end an approach, because the wind has stayed above the limit; "" without one.
    """

    def __init__(self, max_mps: float, force: bool) -> None:
        self._max_mps = max_mps
        self._force = force
        self._below_ns: int | None = None
        self.reason = ""

    def update(self, t_ns: int, state: VehicleState) -> None:
        """Add the newest estimate, in every step of the landing."""
        reason = wind_refusal(state.wind_ned_mps, state.std_gust_mps, self._max_mps)
        if self._force or not reason or self._below_ns is None:
            self._below_ns = t_ns
        self.reason = reason if t_ns - self._below_ns > ABOVE_LIMIT_S * NS_PER_S else ""


def wind_refusal(wind_ned_mps: Vec3 | None, std_gust_mps: float | None, max_mps: float) -> str:
    """Reason not to land in the estimated mean wind, or ""; an unknown wind is none."""
    if wind_ned_mps is None or hypot(*wind_ned_mps[:2]) <= max_mps:
        return ""
    return (
        f"{wind_words(wind_ned_mps, std_gust_mps)}, and a landing is limited to {max_mps:g} m/s (wind_max_mps): "
        "wait for less wind, or use force"
    )


def wind_words(wind_ned_mps: Vec3 | None, std_gust_mps: float | None) -> str:
    """The estimated wind for people."""
    if wind_ned_mps is None:
        return "the wind is unknown"
    mean_mps = hypot(*wind_ned_mps[:2])
    gusts = "" if std_gust_mps is None else f" with gusts to {mean_mps + std_gust_mps:.1f} m/s"
    return f"the wind is {mean_mps:.1f} m/s{gusts}"
