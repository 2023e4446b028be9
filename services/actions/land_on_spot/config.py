"""Settings of the action `land_on_spot`."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class PlainLandingConfig(Config, frozen=True, kw_only=True):
    """Landing on a spot by the vehicle's own position, without UWB and marker.

    Attributes:
        approach_height_min_m: over ground; lower vehicles climb to it before they fly to the spot.
        speed_approach_mps: on the way to the spot.
        speed_high_mps: descent above the slow height.
        speed_low_mps: descent below the slow height.
        slow_height_m: over ground by the laser altimeter.
        slow_margin_m: added to the slow height when only the vehicle's own altitude is known.
        gain_horizontal_1ps: horizontal speed per metre of error.
        speed_horizontal_max_mps: limit of the horizontal speed during the descent.
        contact_mps: a slower descent than this for `contact_s` counts as contact.
        contact_s: see `contact_mps`.
        push_mps: downward speed after contact. Source: spec §8.
        contact_timeout_s: the goal is aborted when the autopilot doesn't detect the ground within this time.
        descent_timeout_s: the goal is aborted when there is no contact within this time.
        speed_leave_mps: upwards, when the vehicle tilts over the obstacle that it touches.
        leave_s: duration of that climb, after which the goal is aborted.
    """

    approach_height_min_m: Positive = 1.5
    speed_approach_mps: Positive = 2.0
    speed_high_mps: Positive = 0.7
    speed_low_mps: Positive = 0.3
    slow_height_m: Positive = 1.5
    slow_margin_m: Positive = 1.0
    gain_horizontal_1ps: Positive = 0.8
    speed_horizontal_max_mps: Positive = 0.5
    contact_mps: Positive = 0.1
    contact_s: Positive = 0.5
    push_mps: Positive = 0.5
    contact_timeout_s: Positive = 15.0
    descent_timeout_s: Positive = 600.0
    speed_leave_mps: Positive = 1.0
    leave_s: Positive = 1.5


class PlatformControlConfig(Config, frozen=True, kw_only=True):
    """Velocity over the platform from the relative pose: proportional and integral part, and the platform's motion.

    Attributes:
        gain_far_1ps: speed per metre of error beyond `far_m`; between `near_m` and `far_m` the gain is interpolated.
        gain_near_1ps: speed per metre of error within `near_m`.
        far_m: beyond it the integral is reset.
        near_m: the integral grows only within it.
        gain_integral_1ps2: speed per integrated error.
        integral_max_mps: limit of the integral's part.
        speed_max_mps: towards the platform.
        acc_max_mps2: of braking before the platform.
    """

    gain_far_1ps: Positive = 0.7
    gain_near_1ps: Positive = 2.2
    far_m: Positive = 3.5
    near_m: Positive = 0.5
    gain_integral_1ps2: Positive = 0.8
    integral_max_mps: Positive = 0.3
    speed_max_mps: Positive = 3.5
    acc_max_mps2: Positive = 1.5


class SearchConfig(Config, frozen=True, kw_only=True):
    """Search for a rover that is out of sight.

    Attributes:
        tries: rounds, each higher and wider than the one before; then the goal ends hovering.
        climb_m: height between two rounds.
        height_max_m: over the platform; no round is higher.
        radius_m: of the first round around the rover's supposed position, and what each other round adds.
        speed_mps: on the way.
        speed_down_max_mps: low, because only the autopilot's height is known, which its barometer may have wrong.
        reached_m: distance at which a corner counts as reached.
        corner_timeout_s: for each corner.
        drive_time_constant_s: the rover's supposed speed decays with this time constant.
    """

    tries: Annotated[int, Meta(ge=1, le=20)] = 3
    climb_m: Positive = 1.5
    height_max_m: Positive = 9.0
    radius_m: Positive = 2.0
    speed_mps: Positive = 1.5
    speed_down_max_mps: Positive = 0.15
    reached_m: Positive = 0.5
    corner_timeout_s: Positive = 10.0
    drive_time_constant_s: Positive = 10.0


class RoverLandingConfig(Config, frozen=True, kw_only=True):
    """Landing on the rover by the estimate of the relative pose. Heights are over the platform.

    The vehicle descends while all of these hold: its horizontal error is inside a cone that narrows downwards, the
    standard deviation of its position is below a limit, and its relative horizontal speed is below the gate.

    Attributes:
        height_approach_m: to which the vehicle comes down on the way.
        clear_m: a vehicle lower than this and beside the platform climbs before it comes near.
        view_per_m: with the tag alone, least height on the way per metre of distance, to keep the tag in view.
        speed_down_max_mps: on the way.
        speed_up_mps: when the vehicle climbs.
        gain_height_1ps: vertical speed per metre.
        cone_m: radius of the cone at height 0.
        cone_per_m: growth of the cone's radius per metre of height.
        cone_widening_s: waiting for this duration adds the cone's own radius to it, every time.
        std_m: limit of the standard deviation at height 0.
        std_per_m: growth of that limit per metre of height.
        std_rough_per_m: far away, the vehicle comes nearer at its height by an invalid estimate, like that of UWB from
            afar, whose standard deviation is below this per metre of distance.
        prediction_s: the error is predicted for this time ahead.
        speed_gate_mps: limit of the relative horizontal speed.
        gain_descent_1ps: rate of descent per metre of height.
        descent_min_mps: least rate of descent.
        descent_max_mps: greatest rate of descent.
        commit_m: below this height the vehicle descends whatever the error is.
        strayed_cones: the vehicle climbs when the error is larger than this number of cone radii.
        feet_below_m: offset of the touchdown per radian of tilt: the feet are below the centre of mass, and the vehicle
            slides downwind while it turns upright and the thrust goes.
        tilt_time_constant_s: of the filter of the tilt.
        contact_m: a lower height than this counts as contact.
        contact_s: a stop of this duration during the descent counts as contact.
        push_mps: downward after contact. Source: spec §8.
        force_below_m: a forced disarm needs a height that is surely below this.
        force_mps: a forced disarm needs a relative speed below this although the vehicle is pushed down.
        force_s: duration for which the conditions of a forced disarm must hold. Source: spec §8, which wants 2 s at
            least; PX4 takes about as long to detect the ground.
        contact_timeout_s: the goal is aborted when the vehicle isn't disarmed within this time after contact.
        blind_m: below this height the platform need not be in sight any more.
        coast_s: the platform may be out of sight for this duration without any effect. Source: spec §8.
        hold_s: duration for which the height is held after that, before the search. Source: spec §8.
        acquire_s: for the first estimate, before the search begins.
        timeout_s: for the whole landing.
        platform_control: horizontal control over the platform.
        search: search for the rover.
    """

    height_approach_m: Positive = 3.0
    clear_m: Positive = 1.0
    view_per_m: Positive = 1.6
    speed_down_max_mps: Positive = 1.2
    speed_up_mps: Positive = 1.0
    gain_height_1ps: Positive = 0.8
    cone_m: Positive = 0.008
    cone_per_m: Positive = 0.08
    cone_widening_s: Positive = 4.0
    std_m: Positive = 0.1
    std_per_m: Positive = 0.15
    std_rough_per_m: Positive = 0.4
    prediction_s: Positive = 0.3
    speed_gate_mps: Positive = 0.5
    gain_descent_1ps: Positive = 0.6
    descent_min_mps: Positive = 0.35
    descent_max_mps: Positive = 1.5
    commit_m: Positive = 0.1
    strayed_cones: Positive = 4.0
    feet_below_m: Positive = 0.22
    tilt_time_constant_s: Positive = 1.0
    contact_m: Positive = 0.03
    contact_s: Positive = 0.6
    push_mps: Positive = 0.5
    force_below_m: Annotated[float, Meta(gt=0.0, le=0.1)] = 0.1
    force_mps: Positive = 0.2
    force_s: Annotated[float, Meta(ge=2.0, le=60.0)] = 3.0
    contact_timeout_s: Positive = 10.0
    blind_m: Positive = 0.25
    coast_s: Positive = 0.5
    hold_s: Positive = 5.0
    acquire_s: Positive = 3.0
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
