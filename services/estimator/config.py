"""Settings of the estimator. What people may change while it runs is in `Tuning`."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Small = Annotated[float, Meta(ge=-10.0, le=10.0)]
Mount = tuple[Small, Small, Small]


class Tuning(Config, frozen=True, kw_only=True):
    """Which inputs are used, and how far everything is trusted; readable and settable while running.

    Source of the names' meaning: thesis §4.3.1. Standard deviations are those of one measurement.

    Attributes:
        use_uwb, use_tag: while no goal has leased another selection.
        std_rover_m: of a rough position of the rover that somebody gives, on each axis.
        std_uwb_m: of a range; larger than its white noise, as each anchor has a constant error besides.
        scale_std_tag: factor on what the tag detector claims.
        std_altimeter_m: of the laser range.
        std_yaw_rover_rad, std_yaw_rate_rover_rps, std_speed_rover_mps: of the rover's compass and odometry.
        std_tilt_rad, std_heading_rad: of the constant part of the vehicle's attitude error.
        std_vel_uav_mps, tau_vel_uav_s: of the slow error of the autopilot's velocity.
        psd_acc_uav_m2ps3, psd_acc_rover_m2ps3: of the accelerations that drive vehicle and rover.
        rate_relative_hz: at most so often the result is published.
    """

    use_uwb: bool = True
    use_tag: bool = True
    std_rover_m: Positive = 3.0
    std_uwb_m: Positive = 0.02
    scale_std_tag: Positive = 1.0
    std_altimeter_m: Positive = 0.035
    std_yaw_rover_rad: Positive = 0.03
    std_yaw_rate_rover_rps: Positive = 0.01
    std_speed_rover_mps: Positive = 0.03
    std_tilt_rad: Positive = 0.01
    std_heading_rad: Positive = 0.026
    std_vel_uav_mps: Positive = 0.025
    tau_vel_uav_s: Positive = 2.5
    psd_acc_uav_m2ps3: Positive = 1.0
    psd_acc_rover_m2ps3: Positive = 0.02
    rate_relative_hz: Annotated[float, Meta(ge=1.0, le=50.0)] = 50.0


class Vehicle(Config, frozen=True, kw_only=True):
    """Where things are mounted, in body FRD from the centre of mass.

    Attributes:
        height_stand_m: of the centre of mass over what the vehicle stands on.
    """

    mount_uwb_frd_m: Mount = (0.0, 0.0, 0.05)
    mount_altimeter_frd_m: Mount = (0.0, 0.0, 0.05)
    height_stand_m: NonNegative = 0.148


class Platform(Config, frozen=True, kw_only=True):
    """The rover's landing platform, level and square."""

    side_m: Positive = 1.0


class Trust(Config, frozen=True, kw_only=True):
    """What is too old, too far off, or not enough to fly by.

    Attributes:
        late_max_s: measurements that are older when they come are dropped.
        early_max_s: so far ahead of its time a measurement may seem to be.
        gate: measurements are dropped whose squared innovation exceeds this quantile of the chi-square distribution
            with as many degrees of freedom; told as the quantile for one and for three of them.
        relock_s: an input that is contradicted for so long is believed.
        silent_max_s: without UWB and tag for longer the result is not valid.
        std_valid_m: nor when the position is known no better than this on an axis.
        odometry_max_s: nor without odometry for so long.
    """

    late_max_s: Positive = 0.4
    early_max_s: Positive = 0.05
    gate: tuple[Positive, Positive] = (10.8, 16.3)
    relock_s: Positive = 1.0
    silent_max_s: Positive = 5.0
    std_valid_m: Positive = 0.5
    odometry_max_s: Positive = 0.3


class EstimatorConfig(Config, frozen=True, kw_only=True):
    tuning: Tuning = Tuning()
    vehicle: Vehicle = Vehicle()
    platform: Platform = Platform()
    trust: Trust = Trust()
