"""Settings of the action `takeoff`."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class TakeoffConfig(Config, frozen=True, kw_only=True):
    """Climb straight up from the ground.

    Attributes:
        altitude_min_m: minimum altitude; a goal with a lower one is refused.
    """

    altitude_min_m: Positive = 0.5
