"""Settings of the action `get_images`."""

from jezero.base.config import Config
from jezero.services.actions.motion.config import Positive


class GetImagesConfig(Config, frozen=True, kw_only=True):
    """Flight on a circle around a target.

    Attributes:
        speed_mps: speed along the circle for a goal without `speed_mps`.
        acceleration_mps2: acceleration along the circle, when speeding up and when braking.
        inwards_max_mps2: maximum centripetal acceleration; small circles are flown more slowly.
        radius_min_m: minimum radius; a goal with a smaller circle is refused.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 0.5
    inwards_max_mps2: Positive = 1.5
    radius_min_m: Positive = 0.5
