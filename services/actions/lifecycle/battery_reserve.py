"""Refusal of a goal after which the battery would be below the level at which the autopilot ends the flight."""

from jezero.schemas.state import Battery
from jezero.vehicle_config import BatteryConfig

RESOLUTION = 0.01
"""The autopilot reports whole percents, so that half of one may be missing."""
LANDING_MPS, DISARM_S = 0.5, 2.0
"""Mean speed of a landing, which is slow near the ground, and the time until the motors are off."""
WAY_HOME_MIN_S = 20.0
"""A return takes at least this time: the vehicle climbs to a safe height, flies to its place, comes down and lands."""


def battery_refusal(flight_s: float, landing_from_m: float, battery: Battery | None, config: BatteryConfig) -> str:
    """Reason why the battery doesn't hold a flight, or ""; a battery that nobody knows holds every flight.

    Args:
        flight_s: planned duration of the flight.
        landing_from_m: height from which the vehicle must still land after it; 0 for no landing.
    """
    if battery is None or battery.remaining is None or battery.critical is None:
        return ""
    home_s = max(landing_from_m / LANDING_MPS + DISARM_S, WAY_HOME_MIN_S) if landing_from_m > 0.0 else 0.0
    used = config.used(flight_s + home_s)
    least = max(battery.remaining - 0.5 * RESOLUTION, 0.0)
    if least - used >= battery.critical:
        return ""
    home = f" and {home_s:.0f} s for the way home after it" if home_s else ""
    return (
        f"the battery is too low: {flight_s:.0f} s of flight{home} use {_percent(used)}, only {_percent(least)} are "
        f"sure to be there, and {_percent(battery.critical)} must be left for the autopilot's return: charge the "
        "battery, or fly a shorter way"
    )


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.1f} %"
