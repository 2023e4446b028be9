"""Settings of all action servers: one file, as they share limits and ways of moving."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e4)]


class Limits(Config, frozen=True, kw_only=True):
    """What no goal may exceed; beyond, it is refused with the limit.

    Attributes:
        altitude_max_m: above the world's origin, for a takeoff above the take-off point.
        distance_max_m: horizontally from the world's origin.
        speed_min_mps, speed_max_mps: what a goal may ask for.
    """

    altitude_max_m: Positive = 120.0
    distance_max_m: Positive = 500.0
    speed_min_mps: Positive = 0.1
    speed_max_mps: Positive = 10.0


class MoveConfig(Config, frozen=True, kw_only=True):
    """How the reference point runs along a straight line, and when its end counts as reached.

    Attributes:
        accel_mps2: of the reference, speeding up and braking.
        speed_up_mps, speed_down_mps: its greatest vertical speeds.
        yaw_rate_rps: how fast the heading setpoint turns.
        lead_m, lead_s: the reference waits when it is more than lead_m + lead_s * speed ahead of the vehicle.
        reached_m, reached_mps, reached_s: distance and speed below which the vehicle must stay for this long.
        progress_timeout_s: a goal is aborted when the vehicle gets no nearer for this long.
    """

    accel_mps2: Positive = 1.0
    speed_up_mps: Positive = 1.5
    speed_down_mps: Positive = 1.0
    yaw_rate_rps: Positive = 0.8
    lead_m: Positive = 1.0
    lead_s: Positive = 0.5
    reached_m: Positive = 0.15
    reached_mps: Positive = 0.2
    reached_s: Positive = 1.0
    progress_timeout_s: Positive = 20.0


class TakeoffConfig(Config, frozen=True, kw_only=True):
    """Straight up.

    Attributes:
        lead_m: how far the reference rises before the vehicle leaves the ground, which it then catches up with.
        arming_timeout_s: aborted when the vehicle isn't armed by then.
    """

    altitude_min_m: Positive = 0.5
    lead_m: Positive = 0.6
    arming_timeout_s: Positive = 10.0


class GoToConfig(Config, frozen=True, kw_only=True):
    """Attributes: takeoff_altitude_m: climbed first with `do_takeoff`."""

    speed_mps: Positive = 2.0
    takeoff_altitude_m: Positive = 2.0


class LandConfig(Config, frozen=True, kw_only=True):
    """Landing on a spot by the vehicle's own position.

    Attributes:
        approach_height_min_m: over ground; lower vehicles climb to it before they fly to the spot.
        speed_approach_mps: on the way to the spot.
        speed_high_mps, speed_low_mps: descent above and below the slow height.
        slow_height_m: over ground by the laser altimeter.
        slow_margin_m: added to it when only the vehicle's own altitude is known.
        gain_horizontal_1ps: horizontal speed per metre of error.
        speed_horizontal_max_mps: limit of it.
        contact_height_m: below this range the vehicle is taken to touch.
        contact_mps, contact_s: descending slower than this for so long is taken as touching.
        push_mps: downward speed after contact. Source: spec §8.
        contact_timeout_s: aborted when the autopilot doesn't see the ground by then.
        descent_timeout_s: aborted when nothing is touched by then.
        speed_leave_mps, leave_s: upwards when the vehicle leans over what it touches, before the goal is aborted.
    """

    approach_height_min_m: Positive = 1.5
    speed_approach_mps: Positive = 2.0
    speed_high_mps: Positive = 0.7
    speed_low_mps: Positive = 0.3
    slow_height_m: Positive = 1.5
    slow_margin_m: Positive = 1.0
    gain_horizontal_1ps: Positive = 0.8
    speed_horizontal_max_mps: Positive = 0.5
    contact_height_m: Positive = 0.16
    contact_mps: Positive = 0.1
    contact_s: Positive = 0.5
    push_mps: Positive = 0.5
    contact_timeout_s: Positive = 15.0
    descent_timeout_s: Positive = 600.0
    speed_leave_mps: Positive = 1.0
    leave_s: Positive = 1.5


class PadControlConfig(Config, frozen=True, kw_only=True):
    """Velocity over the platform from the relative pose: proportional, integral, and what the platform does.

    Attributes:
        gain_far_1ps, gain_near_1ps: speed per metre of error beyond `far_m` and within `near_m`, linear in between.
        gain_integral_1ps2: grows only within `near_m`; beyond `far_m` the integral is reset.
        integral_max_mps: limit of it.
        speed_max_mps, acc_max_mps2: towards the platform, and braking before it.
    """

    gain_far_1ps: Positive = 0.7
    gain_near_1ps: Positive = 2.2
    far_m: Positive = 3.5
    near_m: Positive = 0.5
    gain_integral_1ps2: Positive = 0.8
    integral_max_mps: Positive = 0.3
    speed_max_mps: Positive = 3.5
    acc_max_mps2: Positive = 1.5


class RoverLandConfig(Config, frozen=True, kw_only=True):
    """Landing on the rover by the estimate of the relative pose. Heights are over the platform.

    Attributes:
        height_approach_m: up to here the vehicle comes down on the way.
        clear_m, beside_m: lower than the first and farther away than the second, it climbs before it comes near.
        view_per_m: with the tag alone, the height on the way is at least the distance times this, to keep it in view.
        speed_down_max_mps, speed_up_mps: on the way, and when it climbs.
        gain_height_1ps: vertical speed per metre.
        cone_m, cone_per_m: it descends only while the horizontal error is below the first + the second times height.
        std_m, std_per_m: and only while the position is known better than the first + the second times height.
        rough_share: farther away it comes nearer at its height by an estimate that is known better than this share of
            the distance, though it is not valid: UWB from afar.
        foresight_s: the error is that of so much later.
        cone_patience_s: the cone is twice as wide after waiting for so long, three times after twice as long, ...
        speed_gate_mps: and only while the relative horizontal speed is below this.
        gain_descent_1ps, descent_min_mps, descent_max_mps: rate of descent per metre of height, and its limits.
        commit_m: below this height it descends whatever the error is.
        strayed_cones: it climbs when the error is so many times the cone's.
        feet_below_m: below the centre of mass, and more: so many metres downwind per radian of lean ends the vehicle
            from where its centre of mass was at contact, by turning upright and by sliding while the thrust goes.
        lean_tau_s: the lean is averaged over so long.
        contact_m, contact_s: so low, or stopped for so long although it shall descend, is contact.
        push_mps: downward after contact. Source: spec §8.
        force_below_m, force_mps, force_s: when the autopilot doesn't see the ground, but for the third the vehicle has
            surely been lower than the first and slower than the second although it is pushed down, it is disarmed by
            force. Source: spec §8, which wants 2 s at least; PX4 takes about as long to notice the ground.
        range_force_max_m: and only while the altimeter measures nothing above this, tilt-corrected.
        contact_timeout_s: aborted when neither happened by then.
        blind_m: below this height the target need not be seen any more.
        on_platform_m: a touchdown farther from its middle is no success.
        coast_s: the target may be out of sight for so long without any effect. Source: spec §8, as the next.
        hold_s: then the height is held for so long, then it is searched for.
        acquire_s: for the first estimate, before the search begins.
        timeout_s: for all of it.
    """

    height_approach_m: Positive = 3.0
    clear_m: Positive = 1.0
    beside_m: Positive = 0.8
    view_per_m: Positive = 1.6
    speed_down_max_mps: Positive = 1.2
    speed_up_mps: Positive = 1.0
    gain_height_1ps: Positive = 0.8
    cone_m: Positive = 0.008
    cone_per_m: Positive = 0.08
    std_m: Positive = 0.1
    std_per_m: Positive = 0.15
    rough_share: Positive = 0.4
    foresight_s: Positive = 0.3
    cone_patience_s: Positive = 4.0
    speed_gate_mps: Positive = 0.5
    gain_descent_1ps: Positive = 0.6
    descent_min_mps: Positive = 0.35
    descent_max_mps: Positive = 1.5
    commit_m: Positive = 0.1
    strayed_cones: Positive = 4.0
    feet_below_m: Positive = 0.22
    lean_tau_s: Positive = 1.0
    contact_m: Positive = 0.03
    contact_s: Positive = 0.6
    push_mps: Positive = 0.5
    force_below_m: Annotated[float, Meta(gt=0.0, le=0.1)] = 0.1
    force_mps: Positive = 0.2
    force_s: Annotated[float, Meta(ge=2.0, le=60.0)] = 3.0
    range_force_max_m: Positive = 0.2
    contact_timeout_s: Positive = 10.0
    blind_m: Positive = 0.25
    on_platform_m: Positive = 0.5
    coast_s: Positive = 0.5
    hold_s: Positive = 5.0
    acquire_s: Positive = 3.0
    timeout_s: Positive = 180.0


class SearchConfig(Config, frozen=True, kw_only=True):
    """Looking for a rover out of sight.

    Attributes:
        tries: rounds, each higher and wider; then the goal ends hovering.
        climb_m: by which each round is higher than the one before; never above `height_max_m` over the platform.
        radius_m: of the first round's corners around where the rover is believed; the others add the same.
        speed_mps: on the way.
        speed_down_max_mps: as the height is the autopilot's word only, which its barometer may have wrong.
        reached_m: of a corner.
        corner_timeout_s: for each corner.
        tau_drive_s: the rover is believed to drive on as it was seen, ever more slowly with this time constant.
    """

    tries: Annotated[int, Meta(ge=1, le=20)] = 3
    climb_m: Positive = 1.5
    height_max_m: Positive = 9.0
    radius_m: Positive = 2.0
    speed_mps: Positive = 1.5
    speed_down_max_mps: Positive = 0.15
    reached_m: Positive = 0.5
    corner_timeout_s: Positive = 10.0
    tau_drive_s: Positive = 10.0


class TrackingConfig(Config, frozen=True, kw_only=True):
    """Following a moving reference with velocity setpoints.

    Attributes:
        rate_hz: setpoints per second.
        gain_1ps, gain_integral_1ps2, gain_derivative: velocity per error of position, its integral and its derivative.
        integral_within_m: the integral grows only nearer to the reference than this.
        integral_max_mps, correction_max_mps: limits of the integral, and of the rest of the correction.
        acceleration_max_mps2: limit of what is fed forward.
        lag_free_m, lag_max_m: the reference slows down when the vehicle is farther from it, and waits at the second.
        progress_timeout_s: a goal is aborted when the reference had to wait for so long.
    """

    rate_hz: Positive = 100.0
    gain_1ps: Positive = 2.5
    gain_integral_1ps2: Positive = 1.5
    gain_derivative: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.2
    integral_within_m: Positive = 0.5
    integral_max_mps: Positive = 0.3
    correction_max_mps: Positive = 1.0
    acceleration_max_mps2: Positive = 3.0
    lag_free_m: Positive = 0.3
    lag_max_m: Positive = 1.0
    progress_timeout_s: Positive = 20.0


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """From a goal's arrival to its result.

    Attributes:
        expiry_s: older goals are refused.
        status_age_max_s, odometry_age_max_s, altimeter_age_max_s, estimate_age_max_s: older ones count as lost.
        look_timeout_s: for the inputs of a goal that is accepted only by what they say.
        prepare_timeout_s: for what is worked out before a goal is accepted.
        acquire_timeout_s: for the bridge's answer.
        release_hover_timeout_s, release_disarm_timeout_s: for one answer; asked again after it.
        release_give_up_s: after which a goal ends without the bridge's answer.
        step_rate_hz: of the server's steps while nothing arrives.
        setpoint_rate_hz, feedback_rate_hz: while a goal runs.
    """

    expiry_s: Positive = 30.0
    status_age_max_s: Positive = 1.0
    odometry_age_max_s: Positive = 0.5
    altimeter_age_max_s: Positive = 0.3
    estimate_age_max_s: Positive = 0.3
    look_timeout_s: Positive = 1.5
    prepare_timeout_s: Positive = 20.0
    acquire_timeout_s: Positive = 1.0
    release_hover_timeout_s: Positive = 6.0
    release_disarm_timeout_s: Positive = 12.0
    release_give_up_s: Positive = 20.0
    step_rate_hz: Positive = 10.0
    setpoint_rate_hz: Positive = 50.0
    feedback_rate_hz: Positive = 10.0


class GetImagesConfig(Config, frozen=True, kw_only=True):
    """Flying around a target.

    Attributes:
        speed_mps: along the circle, when the goal names none.
        acceleration_mps2: along the circle, speeding up and braking.
        inwards_max_mps2: the speed is lowered where the circle is so small that it would exceed this.
        velocity_lead_s: velocity setpoints are those of so much later, as the vehicle's velocity follows them so late:
            without it, it is carried out of the circle.
        radius_min_m: smaller circles are refused.
        settled_rad, settled_s: the turn begins when the vehicle has faced the centre to this for so long.
        roll_camera_max_rad: the camera's roll axis turns no farther.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 0.5
    inwards_max_mps2: Positive = 1.5
    velocity_lead_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.11
    radius_min_m: Positive = 0.5
    settled_rad: Positive = 0.035
    settled_s: Positive = 0.5
    roll_camera_max_rad: Positive = 0.6


class CaptureConfig(Config, frozen=True, kw_only=True):
    """Taking pictures.

    Attributes:
        late_max_s: a goal is aborted when a planned point's picture hasn't come so long after the vehicle passed it.
        history_s: what was measured is kept for so long, to be there when the picture comes; later ones are dropped.
        sensor_age_max_s: what was measured so long before or after an exposure is not its.
        height_stand_m: of the vehicle's centre of mass over the point that its position is of.
    """

    late_max_s: Positive = 2.0
    history_s: Positive = 2.0
    sensor_age_max_s: Positive = 0.3
    height_stand_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.148


class CoverageConfig(Config, frozen=True, kw_only=True):
    """Mapping an area.

    Attributes:
        speed_mps: along the lines, when the goal names none.
        acceleration_mps2: in turns, speeding up and braking.
        cut: a turn begins so long before its corner, in line distances.
        pictures_max: a goal that needs more is refused: its result, which tells of each, would be too long to send.
        camera_rate_hz, focal_px, width_px, height_px: of the camera, for overlaps and the bound of the speed.
    """

    speed_mps: Positive = 1.0
    acceleration_mps2: Positive = 1.0
    cut: Annotated[float, Meta(gt=0.0, le=0.5)] = 0.5
    pictures_max: Annotated[int, Meta(ge=1, le=3000)] = 3000
    camera_rate_hz: Positive = 15.0
    focal_px: Positive = 381.36
    width_px: Positive = 640.0
    height_px: Positive = 480.0


class ActionsConfig(Config, frozen=True, kw_only=True):
    limits: Limits = Limits()
    lifecycle: LifecycleConfig = LifecycleConfig()
    move: MoveConfig = MoveConfig()
    takeoff: TakeoffConfig = TakeoffConfig()
    go_to: GoToConfig = GoToConfig()
    land_on_spot: LandConfig = LandConfig()
    land_on_rover: RoverLandConfig = RoverLandConfig()
    pad_control: PadControlConfig = PadControlConfig()
    search: SearchConfig = SearchConfig()
    tracking: TrackingConfig = TrackingConfig()
    get_images: GetImagesConfig = GetImagesConfig()
    capture: CaptureConfig = CaptureConfig()
    area_coverage: CoverageConfig = CoverageConfig()
