"""Settings of the action `go_to`."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class GoToConfig(Config, frozen=True, kw_only=True):
    """Straight flight to a target.

    Attributes:
        speed_mps: speed for a goal without `speed_mps`, and on the way to a circle or an area.
        takeoff_altitude_m: altitude of the takeoff with `do_takeoff`, above the take-off point.
    """

    speed_mps: Positive = 2.0
    takeoff_altitude_m: Positive = 2.0
