"""Settings of the action `return_home`."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive

Horizontal = Annotated[float, Meta(ge=-1e4, le=1e4)]


class ReturnHomeConfig(Config, frozen=True, kw_only=True):
    """The way home, and the places at which it may end.

    Attributes:
        safe_height_m: height above the world's origin at which the vehicle flies home, if it isn't higher.
        near_m: horizontal distance from the place below which the vehicle does not climb first.
        speed_mps: speed on the way.
        height_arrival_m: height over the place to which the vehicle descends before the landing begins; UWB, camera and
            altimeter find the rover from there.
        rover_std_max_m: standard deviation of the rover's position up to which the vehicle flies there and searches,
            while the rover is out of sight.
        rally_points_ned_m: north and east of places on the ground where the vehicle may land.
    """

    safe_height_m: Positive = 10.0
    near_m: Positive = 5.0
    speed_mps: Positive = 4.0
    height_arrival_m: Positive = 6.0
    rover_std_max_m: Positive = 10.0
    rally_points_ned_m: Annotated[tuple[tuple[Horizontal, Horizontal], ...], Meta(max_length=100)] = ()
