"""Settings of the estimator. `Tuning` holds those that can be changed while it runs."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]


class Tuning(Config, frozen=True, kw_only=True):
    """Inputs to use, and the noise of sensors and motion; readable and settable while the estimator runs.

    Source: thesis §4.3.1. Each standard deviation is that of one measurement, unless stated otherwise.

    Attributes:
        use_uwb: fuse UWB ranges, unless a goal's lease says otherwise.
        use_tag: fuse tag detections, unless a goal's lease says otherwise.
        std_rover_m: standard deviation of a given prior position of the rover, on each axis.
        std_uwb_m: standard deviation of a range; larger than its white noise, as each anchor also has a bias.
        scale_std_tag: factor on the standard deviations that the tag detector reports.
        std_altimeter_m: standard deviation of the laser range.
        std_yaw_rover_rad: standard deviation of the rover's compass.
        std_yaw_rate_rover_rps: standard deviation of the rover's yaw rate.
        std_speed_rover_mps: standard deviation of the rover's speed.
        std_tilt_rad: standard deviation of the constant part of the vehicle's tilt error.
        std_heading_rad: standard deviation of the constant part of the vehicle's heading error.
        std_vel_uav_mps: standard deviation of the slow error of the autopilot's velocity.
        tau_vel_uav_s: time constant of that error.
        psd_acc_uav_m2ps3: power spectral density of the vehicle's acceleration (process noise).
        psd_acc_rover_m2ps3: power spectral density of the rover's acceleration (process noise).
        rate_relative_hz: greatest rate at which the estimate is published.
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


class ValidityConfig(Config, frozen=True, kw_only=True):
    """Limits on the age, innovation and covariance beyond which a measurement or the estimate is rejected.

    Attributes:
        max_age_s: a measurement that is older on arrival is dropped.
        max_lead_s: a measurement whose time stamp is further in the future is dropped.
        gate: innovation gate, as chi-square quantiles for one and for three degrees of freedom; a measurement whose
            normalised squared innovation exceeds it is rejected.
        rejection_timeout_s: after an input was rejected for this time, the filter is reset to it.
        aiding_timeout_s: the estimate is invalid when neither UWB nor tag was fused for this time.
        std_pos_max_m: the estimate is invalid when the position's standard deviation exceeds this on any axis.
        odometry_timeout_s: the estimate is invalid when no odometry arrived for this time.
    """

    max_age_s: Positive = 0.4
    max_lead_s: Positive = 0.05
    gate: tuple[Positive, Positive] = (10.8, 16.3)
    rejection_timeout_s: Positive = 1.0
    aiding_timeout_s: Positive = 5.0
    std_pos_max_m: Positive = 0.5
    odometry_timeout_s: Positive = 0.3


class EstimatorConfig(Config, frozen=True, kw_only=True):
    """Tables of `estimator.toml`."""

    tuning: Tuning = Tuning()
    validity: ValidityConfig = ValidityConfig()
