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
        cut: distance before a corner at which its turn begins, in line distances.
        pictures_max: a goal that needs more is refused, because its result would be too long to send.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 1.0
    cut: Annotated[float, Meta(gt=0.0, le=0.5)] = 0.5
    pictures_max: Annotated[int, Meta(ge=1, le=3000)] = 3000
