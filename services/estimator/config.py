"""Settings of the estimator. `Tuning` holds those that can be changed while it runs."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]


class Tuning(Config, frozen=True, kw_only=True):
    """Selection of the inputs, and standard deviations of sensors and motion; readable and settable while the estimator
    runs.

    Source: thesis §4.3.1. Each standard deviation is that of one measurement, unless stated otherwise.

    Attributes:
        use_uwb: fuse UWB ranges, unless a goal leases another selection.
        use_tag: fuse tag detections, unless a goal leases another selection.
        std_rover_m: standard deviation of a given prior position of the rover, on each axis.
        std_uwb_m: standard deviation of a UWB range; larger than its white noise, as each anchor also has a bias.
        std_uwb_bias_m: standard deviation of the error that all UWB ranges share, which the filter estimates.
        scale_std_tag: factor on all standard deviations of a tag's position and heading.
        std_tag_scale: standard deviation of the relative error of distances by the tags, as from tags printed in
            another size, which the filter estimates.
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

    use_uwb: bool = True
    use_tag: bool = True
    std_rover_m: Annotated[float, Meta(ge=0.01, le=100.0)] = 3.0
    std_uwb_m: Annotated[float, Meta(ge=0.001, le=10.0)] = 0.02
    std_uwb_bias_m: Annotated[float, Meta(ge=0.001, le=10.0)] = 0.1
    scale_std_tag: Annotated[float, Meta(ge=0.1, le=100.0)] = 1.0
    std_tag_scale: Annotated[float, Meta(ge=0.0001, le=1.0)] = 0.05
    std_altimeter_m: Annotated[float, Meta(ge=0.001, le=10.0)] = 0.035
    std_yaw_rover_rad: Annotated[float, Meta(ge=0.001, le=3.0)] = 0.03
    std_yaw_rate_rover_rps: Annotated[float, Meta(ge=0.0001, le=10.0)] = 0.01
    std_speed_rover_mps: Annotated[float, Meta(ge=0.001, le=10.0)] = 0.03
    std_tilt_rad: Annotated[float, Meta(ge=0.0001, le=0.5)] = 0.01
    std_heading_rad: Annotated[float, Meta(ge=0.0001, le=1.0)] = 0.026
    std_vel_uav_mps: Annotated[float, Meta(ge=0.001, le=5.0)] = 0.025
    tau_vel_uav_s: Annotated[float, Meta(ge=0.1, le=1000.0)] = 2.5
    psd_acc_uav_m2ps3: Annotated[float, Meta(ge=0.0001, le=1000.0)] = 1.0
    psd_acc_rover_m2ps3: Annotated[float, Meta(ge=0.0001, le=1000.0)] = 0.02
    rate_relative_hz: Annotated[float, Meta(ge=1.0, le=50.0)] = 50.0


class ValidityConfig(Config, frozen=True, kw_only=True):
    """Limits on the age, innovation and covariance beyond which a measurement or the estimate is rejected.

    Attributes:
        max_age_s: maximum age of a measurement at its arrival; an older one is dropped.
        max_lead_s: maximum time by which a measurement's time stamp may be in the future; one with more is dropped.
        gate: innovation gates, as chi-square quantiles for one and for three degrees of freedom; a measurement whose
            normalised squared innovation is larger is rejected.
        rejection_timeout_s: time for which an input may be rejected; then the filter is reset to it.
        aiding_timeout_s: time without a fused UWB range or tag after which the estimate is invalid.
        std_pos_max_m: maximum standard deviation of the position on any axis; with a larger one the estimate is
            invalid.
        odometry_timeout_s: time without odometry after which the estimate is invalid.
    """

    max_age_s: Positive = 0.4
    max_lead_s: Positive = 0.05
    gate: tuple[Positive, Positive] = (10.8, 16.3)
    rejection_timeout_s: Positive = 1.0
    aiding_timeout_s: Positive = 5.0
    std_pos_max_m: Positive = 0.5
    odometry_timeout_s: Positive = 0.3


class EstimatorConfig(Config, frozen=True, kw_only=True):
    """Tables of `estimator.toml`.

    Attributes:
        std_time_s: standard deviation of the time stamps of UWB ranges, tags and the rover's heading: 0 in the
            simulation, 0.02 to 0.05 with drivers, which know the times of arrival only.
        deck_moves: whether the platform heaves like a boat's deck from the start. The estimator finds it out by the
            rover's roll and pitch, or by the tags; a boat that sends no attitude and is landed on by UWB alone needs
            `true`.
        tuning: inputs, standard deviations and rate, which can be changed in flight.
        validity: limits of valid measurements and estimates.
    """

    std_time_s: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.0
    deck_moves: bool = False
    tuning: Tuning = Tuning()
    validity: ValidityConfig = ValidityConfig()
