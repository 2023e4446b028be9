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


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """From a goal's arrival to its result.

    Attributes:
        expiry_s: older goals are refused.
        status_age_max_s, odometry_age_max_s: older ones count as lost.
        acquire_timeout_s: for the bridge's answer.
        release_hover_timeout_s, release_disarm_timeout_s: for one answer; asked again after it.
        release_give_up_s: after which a goal ends without the bridge's answer.
        setpoint_rate_hz, feedback_rate_hz: while a goal runs.
    """

    expiry_s: Positive = 30.0
    status_age_max_s: Positive = 1.0
    odometry_age_max_s: Positive = 0.5
    altimeter_age_max_s: Positive = 0.3
    acquire_timeout_s: Positive = 1.0
    release_hover_timeout_s: Positive = 6.0
    release_disarm_timeout_s: Positive = 12.0
    release_give_up_s: Positive = 20.0
    setpoint_rate_hz: Positive = 50.0
    feedback_rate_hz: Positive = 10.0


class ActionsConfig(Config, frozen=True, kw_only=True):
    limits: Limits = Limits()
    lifecycle: LifecycleConfig = LifecycleConfig()
    move: MoveConfig = MoveConfig()
    takeoff: TakeoffConfig = TakeoffConfig()
    go_to: GoToConfig = GoToConfig()
    land_on_spot: LandConfig = LandConfig()
