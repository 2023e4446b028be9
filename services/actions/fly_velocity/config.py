"""Settings of the action `fly_velocity`."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config
from jezero.services.actions.motion.config import Positive


class FlyVelocityConfig(Config, frozen=True, kw_only=True):
    """Flight by a stream of velocity commands.

    Attributes:
        speed_mps: greatest horizontal speed for a goal without `speed_max_mps`.
        speed_up_mps: greatest speed upwards.
        speed_down_mps: greatest speed downwards.
        accel_mps2: acceleration and deceleration, horizontally and vertically each.
        yaw_rate_max_rps: greatest yaw rate.
        yaw_accel_rps2: change of the yaw rate per second.
        command_age_max_s: age up to which a command is followed; without a newer one the vehicle stops.
        silence_max_s: time without any command after which the goal ends.
        clearance_min_m: least height of the feet over the ground by the altimeter; lower, the vehicle climbs.
    """

    speed_mps: Positive = 3.0
    speed_up_mps: Positive = 1.5
    speed_down_mps: Positive = 1.0
    accel_mps2: Annotated[float, Meta(gt=0.0, le=5.0)] = 1.0
    yaw_rate_max_rps: Annotated[float, Meta(gt=0.0, le=3.0)] = 0.8
    yaw_accel_rps2: Positive = 1.5
    command_age_max_s: Annotated[float, Meta(gt=0.0, le=2.0)] = 0.5
    silence_max_s: Annotated[float, Meta(ge=1.0, le=3600.0)] = 10.0
    clearance_min_m: Annotated[float, Meta(ge=0.3, le=1e3)] = 0.7
