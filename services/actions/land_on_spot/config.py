"""Settings of the action `land_on_spot`."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class PlainLandingConfig(Config, frozen=True, kw_only=True):
    """Landing on a spot by the vehicle's own position, without UWB and marker.

    Attributes:
        approach_height_min_m: over ground; lower vehicles climb to it before they fly to the spot.
        speed_high_mps: descent above the slow height.
        speed_low_mps: descent below the slow height.
        slow_height_m: over ground by the laser altimeter.
        push_mps: downward speed after contact. Source: spec §8.
    """

    approach_height_min_m: Positive = 1.5
    speed_high_mps: Positive = 0.7
    speed_low_mps: Positive = 0.3
    slow_height_m: Positive = 1.5
    push_mps: Positive = 0.5


class PlatformControlConfig(Config, frozen=True, kw_only=True):
    """Velocity over the platform from the relative pose: proportional and integral part, and the platform's motion.

    Attributes:
        gain_far_1ps: speed per metre of error far away; in between the gain is interpolated.
        gain_near_1ps: speed per metre of error near the platform's middle.
        gain_integral_1ps2: speed per integrated error.
        speed_max_mps: towards the platform.
    """

    gain_far_1ps: Positive = 0.7
    gain_near_1ps: Positive = 2.2
    gain_integral_1ps2: Positive = 0.8
    speed_max_mps: Positive = 3.5


class SearchConfig(Config, frozen=True, kw_only=True):
    """Search for a rover that is out of sight.

    Attributes:
        tries: rounds, each higher and wider than the one before; then the goal ends hovering.
        height_max_m: over the platform; no round is higher.
        radius_m: of the first round around the rover's supposed position, and what each other round adds.
    """

    tries: Annotated[int, Meta(ge=1, le=20)] = 3
    height_max_m: Positive = 9.0
    radius_m: Positive = 2.0


class RoverLandingConfig(Config, frozen=True, kw_only=True):
    """Landing on the rover by the estimate of the relative pose. Heights are over the platform.

    The vehicle descends while all of these hold: its horizontal error is inside a cone that narrows downwards, the
    standard deviation of its position is below a limit, and its relative horizontal speed is below the gate.

    Attributes:
        height_approach_m: to which the vehicle comes down on the way.
        cone_m: radius of the cone at height 0.
        cone_per_m: growth of the cone's radius per metre of height.
        cone_widening_s: waiting for this duration adds the cone's own radius to it, every time.
        descent_min_mps: least rate of descent.
        descent_max_mps: greatest rate of descent.
        coast_s: the platform may be out of sight for this duration without any effect. Source: spec §8.
        hold_s: duration for which the height is held after that, before the search. Source: spec §8.
        timeout_s: for the whole landing.
        platform_control: horizontal control over the platform.
        search: search for the rover.
    """

    height_approach_m: Positive = 3.0
    cone_m: Positive = 0.008
    cone_per_m: Positive = 0.08
    cone_widening_s: Positive = 4.0
    descent_min_mps: Positive = 0.35
    descent_max_mps: Positive = 1.5
    coast_s: Positive = 0.5
    hold_s: Positive = 5.0
    timeout_s: Positive = 180.0
    platform_control: PlatformControlConfig = PlatformControlConfig()
    search: SearchConfig = SearchConfig()


class LandOnSpotConfig(Config, frozen=True, kw_only=True):
    """Both ways of landing.

    Attributes:
        plain: on a spot, by the vehicle's own position.
        rover: on the rover, by UWB or the marker.
    """

    plain: PlainLandingConfig = PlainLandingConfig()
    rover: RoverLandingConfig = RoverLandingConfig()
