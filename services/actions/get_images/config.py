"""Settings of the action `get_images`."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class GetImagesConfig(Config, frozen=True, kw_only=True):
    """A flight around a target.

    Attributes:
        speed_mps: along the circle, when the goal names none.
        acceleration_mps2: along the circle, speeding up and braking.
        inwards_max_mps2: greatest centripetal acceleration; small circles are flown more slowly.
        radius_min_m: smaller circles are refused.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 0.5
    inwards_max_mps2: Positive = 1.5
    radius_min_m: Positive = 0.5
