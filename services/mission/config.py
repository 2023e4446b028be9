"""Settings of the mission service."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config


class MissionConfig(Config, frozen=True, kw_only=True):
    """When the vehicle flies home by itself, from any goal and from a hover.

    Attributes:
        return_when_low: fly home while the battery still holds the way.
        way_margin: the way home may use this many times the charge that its plan needs; the battery's `reserve` of
            `vehicle.toml` is left after it.
        ground_loss_s: fly home when the ground station has been silent for this long; 0 flies on. A ground station that
            was not heard since the takeoff is not missed.
    """

    return_when_low: bool = True
    way_margin: Annotated[float, Meta(ge=1.0, le=10.0)] = 1.3
    ground_loss_s: Annotated[float, Meta(ge=0.0, le=3600.0)] = 0.0
