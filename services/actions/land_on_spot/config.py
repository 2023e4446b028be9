"""Settings of the action `land_on_spot`."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config
from jezero.services.actions.motion.config import Positive


class PlainLandingConfig(Config, frozen=True, kw_only=True):
    """Landing on a spot by the vehicle's own position, without UWB and tags. Heights are over ground.

    Attributes:
        approach_height_min_m: minimum height of the flight to the spot; a lower vehicle climbs to it first.
        speed_high_mps: descent speed above `slow_height_m`.
        speed_low_mps: descent speed below `slow_height_m`.
        slow_height_m: height by the laser altimeter at which the descent becomes slow.
        push_mps: commanded downward speed after contact.
    """

    approach_height_min_m: Positive = 1.5
    speed_high_mps: Positive = 0.7
    speed_low_mps: Positive = 0.3
    slow_height_m: Positive = 1.5
    push_mps: Positive = 0.5


class PlatformControlConfig(Config, frozen=True, kw_only=True):
    """PI control of the horizontal position over the platform, with the platform's velocity fed forward.

    Attributes:
        gain_far_1ps: speed per position error far away from the platform's middle; in between, the gain is
            interpolated.
        gain_near_1ps: speed per position error near the platform's middle.
        gain_integral_1ps2: speed per integrated position error.
        speed_max_mps: maximum speed towards the platform.
        deceleration_mps2: deceleration before the platform, which limits the speed towards it.
    """

    gain_far_1ps: Positive = 0.7
    gain_near_1ps: Positive = 2.2
    gain_integral_1ps2: Positive = 0.8
    speed_max_mps: Positive = 3.5
    deceleration_mps2: Positive = 1.5


class SearchConfig(Config, frozen=True, kw_only=True):
    """Search for a rover that is out of sight.

    Attributes:
        tries: number of rounds, each higher and wider than the one before; after the last one the goal ends with a
            hover.
        height_max_m: maximum height of a round over the platform.
        radius_m: radius of the first round around the estimated position of the rover; each next round is wider by as
            much.
    """

    tries: Annotated[int, Meta(ge=1, le=20)] = 3
    height_max_m: Positive = 9.0
    radius_m: Positive = 2.0


class LandingBoundsConfig(Config, frozen=True, kw_only=True):
    """Bounds of a landing on the rover; one that exceeds them ends with a hover and the bound in its reason.

    Attributes:
        distance_max_m: maximum horizontal distance from where the landing began.
        climb_max_m: maximum height above where the landing began.
        speed_rover_max_mps: the rover's top speed over ground.
    """

    distance_max_m: Positive = 150.0
    climb_max_m: Positive = 12.0
    speed_rover_max_mps: Positive = 5.0


class DeckConfig(Config, frozen=True, kw_only=True):
    """Landing on a platform that heaves and tilts, as a boat's deck. Significant values are two standard deviations.

    Attributes:
        observe_s: time for which the motion is observed before the descent.
        climb_max_mps: greatest significant vertical speed on which a landing begins its descent.
        tilt_max_rad: greatest significant tilt on which a landing begins its descent.
        height_wait_m: height over the platform at which the vehicle waits for a calm moment.
        climb_calm_mps: greatest vertical speed of the platform, predicted for the touchdown, in a calm moment.
        tilt_calm_rad: greatest tilt of the platform, predicted for the touchdown, in a calm moment.
        widening_s: waiting time after which both limits of a calm moment are twice as large; after twice this time
            three times, and so on.
    """

    observe_s: Positive = 8.0
    climb_max_mps: Positive = 1.0
    tilt_max_rad: Positive = 0.2
    height_wait_m: Positive = 0.4
    climb_calm_mps: Positive = 0.3
    tilt_calm_rad: Positive = 0.06
    widening_s: Positive = 6.0


class RoverLandingConfig(Config, frozen=True, kw_only=True):
    """Landing on the rover by the estimate of the relative position. Heights are over the platform.

    The vehicle descends while its position error, its standard deviation and its relative speed are small enough. The
    limit of the horizontal position error is a cone that is narrow at the platform.

    Attributes:
        height_approach_m: height to which the vehicle descends on its way to the platform.
        cone_m: radius of the cone at height 0.
        cone_per_m: increase of the cone's radius per metre of height.
        cone_widening_s: waiting time after which the cone is twice as wide; after twice this time three times, and so
            on.
        descent_min_mps: minimum descent speed.
        descent_max_mps: maximum descent speed.
        coast_s: time for which the platform may be out of sight without any effect.
        hold_s: time for which the vehicle keeps its height after `coast_s`, before it searches for the rover.
        timeout_s: maximum duration of the whole landing.
        platform_control: horizontal control over the platform.
        search: search for the rover.
        deck: a platform that heaves and tilts.
        bounds: bounds of the whole landing.
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
    deck: DeckConfig = DeckConfig()
    bounds: LandingBoundsConfig = LandingBoundsConfig()


class LandOnSpotConfig(Config, frozen=True, kw_only=True):
    """Both ways of landing.

    Attributes:
        plain: landing on a spot, by the vehicle's own position.
        rover: landing on the rover, by UWB or the tags.
        go_arounds_max: number of go-arounds after contacts in which the vehicle slides or leans; after one more such
            contact the landing ends with a hover.
        wind_max_mps: highest estimated mean wind in which a landing without `force` starts. An approach ends when the
            wind is above it for 3 s.
    """

    plain: PlainLandingConfig = PlainLandingConfig()
    rover: RoverLandingConfig = RoverLandingConfig()
    go_arounds_max: Annotated[int, Meta(ge=0, le=20)] = 3
    wind_max_mps: Positive = 12.0
