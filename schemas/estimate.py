"""Estimates of vehicle and rover, and the parameters of the estimator."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.struct import (
    Angle,
    Finite,
    Message,
    Name,
    NearPositionNed,
    NonNegative,
    Payload,
    PositionNed,
    Text,
    TimeNs,
    VelocityNed,
)

Std = Annotated[float, Meta(gt=0.0, le=1e6)]
"""A standard deviation, or another positive number."""
Covariance3 = tuple[Finite, Finite, Finite, Finite, Finite, Finite]
"""Upper triangle of a symmetric 3x3 matrix, row by row."""
Covariance6 = Annotated[tuple[Finite, ...], Meta(min_length=21, max_length=21)]
"""Upper triangle of a symmetric 6x6 matrix, row by row."""


class TagEstimate(Message, frozen=True, kw_only=True):
    """Pose of the vehicle relative to the platform, from the tags in one image; `t_ns` is the middle of its exposure.

    Attributes:
        tag_ids: ids of the tags that were used.
        pos_uav_rel_rover_ned_m: position of the vehicle's centre of mass minus that of the centre of the platform's
            surface, in NED axes by the vehicle's attitude.
        cov_pos_ned_m2: covariance of this position, which grows with the range; it does not contain the error of the
            attitude.
        range_m: distance from the camera to the centre of the platform.
        yaw_rover_rad: heading of the platform in world NED. None when the angle of view was too flat to measure it.
        std_yaw_rover_rad: standard deviation of the heading. None without a heading.
        reprojection_px: RMS distance of the detected corners from their projection by the estimated pose.
    """

    tag_ids: Annotated[tuple[int, ...], Meta(max_length=8)]
    pos_uav_rel_rover_ned_m: NearPositionNed
    cov_pos_ned_m2: Covariance3
    range_m: NonNegative
    yaw_rover_rad: Angle | None = None
    std_yaw_rover_rad: NonNegative | None = None
    reprojection_px: NonNegative


class DeckMotion(Payload, frozen=True, kw_only=True):
    """Motion of a platform that heaves and tilts, as the deck of a boat. Significant values are two standard deviations
    of the last half minute.

    Attributes:
        acc_down_mps2: vertical acceleration of the platform, positive down.
        roll_rad: roll of the platform.
        pitch_rad: pitch of the platform.
        roll_rate_rps: rate of `roll_rad`.
        pitch_rate_rps: rate of `pitch_rad`.
        climb_significant_mps: significant vertical speed.
        tilt_significant_rad: significant angle between the platform and the level.
        observed_s: time for which the motion has been observed, half a minute at most.
    """

    acc_down_mps2: Finite
    roll_rad: Angle
    pitch_rad: Angle
    roll_rate_rps: Finite
    pitch_rate_rps: Finite
    climb_significant_mps: NonNegative
    tilt_significant_rad: NonNegative
    observed_s: NonNegative


class Relative(Message, frozen=True, kw_only=True):
    """State of the vehicle relative to the centre of the platform's surface.

    As in `Odometry` and `Truth`, the vehicle's position is that of its centre of mass, lowered by the height at which
    the centre of mass is when the vehicle stands. The position is zero for a vehicle that stands on the middle of the
    platform.

    Attributes:
        epoch_id: id of the epoch, see `Clock`.
        valid: the estimate may be used for flying.
        reason: reason why the estimate is invalid, for people; "" for a valid one.
        contradicted: the estimate is invalid because its inputs contradict each other, the altimeter or the vehicle's
            own motion; a better view of the rover does not help.
        pos_uav_rel_rover_ned_m: position of the vehicle minus that of the platform, in NED axes.
        vel_uav_rel_rover_ned_mps: velocity of the vehicle minus that of the platform, in NED axes.
        cov: covariance of the relative position and the relative velocity, in this order.
        vel_rover_ned_mps: velocity of the rover over ground; like the velocity in `odometry`, it includes the
            autopilot's velocity error.
        yaw_rover_rad: heading of the rover.
        yaw_rate_rover_rps: yaw rate of the rover, clockwise as seen from above.
        deck: motion of a platform that heaves and tilts; None for one that stands or drives on even ground.
        use_uwb: the selection in force includes the UWB ranges.
        use_tag: the selection in force includes the tag detections.
        inputs: names of the inputs that were fused in the last second, such as `uwb` and `tag`.
        fused_t_ns: time of the newest UWB or tag measurement that was fused; 0 before the first one.
        goal_id: id of the goal whose selection is in force; "" when the selection is that of the parameters.
        selects: the estimator lends selections to goals. False for an estimator with one fixed set of inputs: goals use
            its estimate whatever selection they would like.
        parameters_version: version of the parameters, which grows by one with each change.
    """

    epoch_id: int
    valid: bool
    reason: Text = ""
    contradicted: bool = False
    pos_uav_rel_rover_ned_m: NearPositionNed
    vel_uav_rel_rover_ned_mps: VelocityNed
    cov: Covariance6
    vel_rover_ned_mps: VelocityNed
    yaw_rover_rad: Angle
    yaw_rate_rover_rps: Finite
    deck: DeckMotion | None = None
    use_uwb: bool
    use_tag: bool
    inputs: Annotated[tuple[Name, ...], Meta(max_length=16)] = ()
    fused_t_ns: TimeNs = 0
    goal_id: str = ""
    selects: bool = True
    parameters_version: int = 0


class RoverEstimate(Message, frozen=True, kw_only=True):
    """State of the rover in the world frame of `odometry`.

    Attributes:
        epoch_id: id of the epoch, see `Clock`.
        valid: the estimate may be used for flying.
        reason: reason why the estimate is invalid, for people; "" for a valid one.
        pos_rover_ned_m: position of the centre of the platform's surface.
        vel_rover_ned_mps: velocity of the rover over ground.
        yaw_rover_rad: heading of the rover.
        std_pos_m: largest standard deviation of the position on any axis.
        reset_offset_ned_m: reset offset of the odometry that the position belongs to, see `Odometry`.
    """

    epoch_id: int
    valid: bool
    reason: Text = ""
    pos_rover_ned_m: NearPositionNed
    vel_rover_ned_mps: VelocityNed
    yaw_rover_rad: Angle
    std_pos_m: NonNegative
    reset_offset_ned_m: NearPositionNed = (0.0, 0.0, 0.0)


class GetParameters(Payload, frozen=True, kw_only=True):
    """Request for the estimator's parameters."""


class SetParameters(Payload, frozen=True, kw_only=True):
    """Request to change the estimator's parameters. None leaves a parameter as it is. Source: thesis §4.3.1, Alg. 8.

    Each standard deviation is that of one measurement, unless stated otherwise.

    Attributes:
        use_uwb: fuse UWB ranges while no goal leases another selection.
        use_tag: fuse tag detections while no goal leases another selection.
        pos_rover_ned_m: approximate position of the rover in world NED, from which the filter restarts.
        std_rover_m: standard deviation of `pos_rover_ned_m`, on each axis.
        std_uwb_m: standard deviation of a UWB range.
        std_uwb_bias_m: standard deviation of the error that all UWB ranges share.
        scale_std_tag: factor on all standard deviations of a tag's position and heading.
        std_tag_scale: standard deviation of the relative error of distances by the tags.
        std_altimeter_m: standard deviation of the altimeter's range.
        std_yaw_rover_rad: standard deviation of the rover's compass.
        std_yaw_rate_rover_rps: standard deviation of the rover's yaw rate.
        std_speed_rover_mps: standard deviation of the rover's speed.
        std_tilt_rad: standard deviation of the constant part of the vehicle's tilt error.
        std_heading_rad: standard deviation of the constant part of the vehicle's heading error.
        std_vel_uav_mps: standard deviation of the slowly varying error of the autopilot's velocity.
        tau_vel_uav_s: time constant of the slowly varying error of the autopilot's velocity.
        psd_acc_uav_m2ps3: power spectral density of the vehicle's acceleration (process noise).
        psd_acc_rover_m2ps3: power spectral density of the rover's acceleration (process noise).
        rate_relative_hz: maximum rate at which `estimate/relative` is published.
    """

    use_uwb: bool | None = None
    use_tag: bool | None = None
    pos_rover_ned_m: PositionNed | None = None
    std_rover_m: Std | None = None
    std_uwb_m: Std | None = None
    std_uwb_bias_m: Std | None = None
    scale_std_tag: Std | None = None
    std_tag_scale: Std | None = None
    std_altimeter_m: Std | None = None
    std_yaw_rover_rad: Std | None = None
    std_yaw_rate_rover_rps: Std | None = None
    std_speed_rover_mps: Std | None = None
    std_tilt_rad: Std | None = None
    std_heading_rad: Std | None = None
    std_vel_uav_mps: Std | None = None
    tau_vel_uav_s: Std | None = None
    psd_acc_uav_m2ps3: Std | None = None
    psd_acc_rover_m2ps3: Std | None = None
    rate_relative_hz: Std | None = None


class Lease(Payload, frozen=True, kw_only=True):
    """Request of a goal for its own selection of inputs. The selection ends 3 s after the last renewal.

    Attributes:
        goal_id: id of the goal.
        use_uwb: fuse UWB ranges.
        use_tag: fuse tag detections.
        pos_rover_ned_m: approximate position of the rover in world NED, from which the filter restarts when the lease
            begins. None keeps the present estimate.
        release: end the lease now.
    """

    goal_id: Name
    use_uwb: bool
    use_tag: bool
    pos_rover_ned_m: PositionNed | None = None
    release: bool = False


class ParametersReply(Payload, frozen=True, kw_only=True):
    """Reply to `GetParameters` and `SetParameters`.

    Attributes:
        accepted: the request was accepted; a refused request changes nothing.
        reason: reason of a refusal, for people.
        version: version of the parameters, which grows by one with each change.
        parameters: all parameters after the request. None for a refused request.
        lease: lease of the goal that selects the inputs now, with the position with which the lease began. None
            while no goal selects inputs.
    """

    accepted: bool
    reason: Text = ""
    version: int = 0
    parameters: SetParameters | None = None
    lease: Lease | None = None


class LeaseReply(Payload, frozen=True, kw_only=True):
    """Reply to `Lease`.

    Attributes:
        accepted: the request was accepted.
        reason: reason of a refusal, for people.
        until_t_ns: vehicle time at which the selection ends unless it is renewed.
    """

    accepted: bool
    reason: Text = ""
    until_t_ns: TimeNs = 0
