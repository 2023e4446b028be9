"""Settings of the action `takeoff`."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class TakeoffConfig(Config, frozen=True, kw_only=True):
    """A climb straight up from the ground.

    Attributes:
        altitude_min_m: lower goals are refused.
        lead_m: height to which the reference rises before the vehicle leaves the ground.
        arming_timeout_s: the goal is aborted when the vehicle isn't armed within this time.
    """

    altitude_min_m: Positive = 0.5
    lead_m: Positive = 0.6
    arming_timeout_s: Positive = 10.0
