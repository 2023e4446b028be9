"""Where the vehicle is relative to the rover, and what the estimator is told to use for it."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.struct import (
    Angle,
    Finite,
    Message,
    Name,
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
    """What one picture with landing tags in it says; `t_ns` is the middle of its exposure.

    Attributes:
        tag_ids: of the tags that were used.
        pos_uav_rel_rover_ned_m: vehicle's centre of mass, where its FRD axes have their origin, minus centre of the
            platform's top, turned to NED by the vehicle's attitude.
        cov_pos_ned_m2: of that position; grows with the range. The attitude's own error is not in it.
        yaw_rover_rad: heading of the platform in world NED; None when the tag was seen too flatly.
        reprojection_px: RMS distance of the corners from where the pose puts them.
    """

    tag_ids: Annotated[tuple[int, ...], Meta(max_length=8)]
    pos_uav_rel_rover_ned_m: PositionNed
    cov_pos_ned_m2: Covariance3
    range_m: NonNegative
    yaw_rover_rad: Angle | None = None
    std_yaw_rover_rad: NonNegative | None = None
    reprojection_px: NonNegative


class Relative(Message, frozen=True, kw_only=True):
    """The vehicle relative to the centre of the platform's top.

    The vehicle's position is, as in `Odometry` and `Truth`, that of its centre of mass lowered by the height at which
    it stands: zero when it stands on the middle of the platform.

    Attributes:
        valid: fit to fly by; `reason` says why it is not.
        pos_uav_rel_rover_ned_m, vel_uav_rel_rover_ned_mps: vehicle minus rover, in NED axes.
        cov: of (position, velocity), in that order.
        vel_rover_ned_mps: of the rover over ground, in the velocity frame of `odometry`.
        inputs: names of what was fused in the last second: odometry, rover, altimeter, uwb, tag.
        fused_t_ns: when the newest UWB or tag measurement that was fused was true; 0 when there was none yet.
        goal_id: whose selection is in force; "" for the parameters' own.
        parameters_version: grows by one with each change of a parameter.
    """

    epoch_id: int
    valid: bool
    reason: Text = ""
    pos_uav_rel_rover_ned_m: PositionNed
    vel_uav_rel_rover_ned_mps: VelocityNed
    cov: Covariance6
    vel_rover_ned_mps: VelocityNed
    yaw_rover_rad: Angle
    yaw_rate_rover_rps: Finite
    use_uwb: bool
    use_tag: bool
    inputs: Annotated[tuple[Name, ...], Meta(max_length=16)] = ()
    fused_t_ns: TimeNs = 0
    goal_id: str = ""
    parameters_version: int = 0


class RoverEstimate(Message, frozen=True, kw_only=True):
    """The rover in the world frame of `odometry`.

    Attributes:
        reset_offset_ned_m: of the odometry that the position belongs to; see `Odometry`.
    """

    epoch_id: int
    valid: bool
    reason: Text = ""
    pos_rover_ned_m: PositionNed
    vel_rover_ned_mps: VelocityNed
    yaw_rover_rad: Angle
    std_pos_m: NonNegative
    reset_offset_ned_m: PositionNed = (0.0, 0.0, 0.0)


class GetParameters(Payload, frozen=True, kw_only=True):
    pass


class SetParameters(Payload, frozen=True, kw_only=True):
    """Change the parameters that are given. Source: thesis §4.3.1, Alg. 8.

    Attributes:
        use_uwb, use_tag: which inputs the filter takes while no goal has leased another selection.
        pos_rover_ned_m: where the rover roughly is, in world NED; the filter starts anew from there.
        std_rover_m: how rough that is.
        std_*: standard deviations of one measurement of each input, and of errors that are estimated besides: the
            vehicle's tilt and heading, and the autopilot's velocity, which wanders within tau_vel_uav_s.
        psd_*: power spectral densities of the accelerations that drive vehicle and rover.
        rate_relative_hz: at most so often the result is published.
    """

    use_uwb: bool | None = None
    use_tag: bool | None = None
    pos_rover_ned_m: PositionNed | None = None
    std_rover_m: Std | None = None
    std_uwb_m: Std | None = None
    scale_std_tag: Std | None = None
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


class ParametersReply(Payload, frozen=True, kw_only=True):
    """All parameters as they are now; `reason` says why a change was refused (then none was made)."""

    accepted: bool
    reason: Text = ""
    version: int = 0
    parameters: SetParameters | None = None


class Lease(Payload, frozen=True, kw_only=True):
    """A goal's own selection of inputs. It ends 3 s after the last renewal, and nothing of it is left.

    Attributes:
        pos_rover_ned_m: where the rover roughly is, for a goal without UWB; used when the lease begins.
        release: end it now.
    """

    goal_id: Name
    use_uwb: bool
    use_tag: bool
    pos_rover_ned_m: PositionNed | None = None
    release: bool = False


class LeaseReply(Payload, frozen=True, kw_only=True):
    """`until_t_ns`: vehicle time at which the selection reverts unless it is renewed."""

    accepted: bool
    reason: Text = ""
    until_t_ns: TimeNs = 0
