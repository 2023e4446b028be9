"""Settings of the action `area_coverage`."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class AreaCoverageConfig(Config, frozen=True, kw_only=True):
    """A flight over all of an area.

    Attributes:
        speed_mps: along the lines, when the goal names none.
        acceleration_mps2: in turns, speeding up and braking.
        pictures_max: a goal that needs more is refused, because its result would be too long to send.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 1.0
    pictures_max: Annotated[int, Meta(ge=1, le=3000)] = 3000
