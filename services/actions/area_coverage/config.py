"""Settings of the action `area_coverage`."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config
from jezero.services.actions.motion.config import Positive


class AreaCoverageConfig(Config, frozen=True, kw_only=True):
    """Flight over an area in lines.

    Attributes:
        speed_mps: speed along the lines for a goal without `speed_mps`.
        acceleration_mps2: acceleration in turns, when speeding up and when braking.
        pictures_max: maximum number of images; a goal that needs more is refused, because its result would be too long
            to send.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 1.0
    pictures_max: Annotated[int, Meta(ge=1, le=3000)] = 3000
