"""Settings of the action `get_images`."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class GetImagesConfig(Config, frozen=True, kw_only=True):
    """A flight around a target.

    Attributes:
        speed_mps: along the circle, when the goal names none.
        acceleration_mps2: along the circle, speeding up and braking.
        inwards_max_mps2: greatest centripetal acceleration; small circles are flown more slowly.
        velocity_lead_s: time by which the velocity setpoints are ahead, because the vehicle's velocity follows them
            late by that much; without it, the vehicle is carried out of the circle.
        radius_min_m: smaller circles are refused.
        settled_rad: the vehicle faces the centre within this heading error.
        settled_s: the turn begins when the vehicle has faced the centre for this duration.
        roll_camera_max_rad: limit of the camera's roll axis.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 0.5
    inwards_max_mps2: Positive = 1.5
    velocity_lead_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.11
    radius_min_m: Positive = 0.5
    settled_rad: Positive = 0.035
    settled_s: Positive = 0.5
    roll_camera_max_rad: Positive = 0.6
