"""Settings of the action `go_to`."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class GoToConfig(Config, frozen=True, kw_only=True):
    """A straight flight to a target.

    Attributes:
        speed_mps: when the goal names none, and on the way to an orbit or an area.
        takeoff_altitude_m: of the takeoff that comes first with `do_takeoff`.
    """

    speed_mps: Positive = 2.0
    takeoff_altitude_m: Positive = 2.0
