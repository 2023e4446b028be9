"""Settings of the ground station."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config


class GroundStationConfig(Config, frozen=True, kw_only=True):
    """Where the ground station listens, and how often its pages get new values.

    Attributes:
        port: TCP port on this machine's loopback address. Another one is taken when it is busy.
        rate_hz: how often a page gets new values.
        rate_camera_hz: how often a page gets a new image of the camera, while it shows the images.
    """

    port: Annotated[int, Meta(ge=1, le=65535)] = 8080
    rate_hz: Annotated[float, Meta(ge=0.5, le=30.0)] = 10.0
    rate_camera_hz: Annotated[float, Meta(ge=0.1, le=15.0)] = 5.0
