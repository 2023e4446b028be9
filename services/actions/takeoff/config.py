"""Settings of the action `takeoff`."""

from jezero.runtime.config import Config


class TakeoffConfig(Config, frozen=True, kw_only=True):
    """Climb straight up from the ground: its speed is in `move`, its least altitude in the limits of `vehicle.toml`."""
