"""Settings that several actions share: straight flights, tracking of a moving reference."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e4)]


class MoveConfig(Config, frozen=True, kw_only=True):
    """Motion of the reference point along a straight path, and the test of arrival at its end.

    The vehicle has arrived when it has been near and slow for `reached_s`.

    Attributes:
        accel_mps2: of the reference, speeding up and braking.
        speed_up_mps: greatest speed of the reference upwards.
        speed_down_mps: greatest speed of the reference downwards.
        yaw_rate_rps: rate at which the heading setpoint turns.
        lead_m: the reference waits when it is more than `lead_m + lead_s * speed` ahead of the vehicle.
        lead_s: see `lead_m`.
        reached_m: the vehicle is near the end within this distance.
        reached_mps: the vehicle is slow below this speed.
        reached_s: duration for which it must be near and slow.
        progress_timeout_s: a goal is aborted when the vehicle gets no nearer for this duration.
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


class TrackingConfig(Config, frozen=True, kw_only=True):
    """Tracking of a moving reference with velocity setpoints.

    Attributes:
        rate_hz: setpoints per second.
        gain_1ps: velocity per metre of position error.
        gain_integral_1ps2: velocity per integrated position error.
        gain_derivative: velocity per velocity error.
        integral_within_m: the integral grows only at a smaller position error than this.
        integral_max_mps: limit of the integral's part.
        correction_max_mps: limit of the proportional and the derivative part together.
        acceleration_max_mps2: limit of the acceleration that is fed forward.
        lag_free_m: the reference slows down when the vehicle is farther from it than this.
        lag_max_m: the reference waits when the vehicle is farther from it than this.
        progress_timeout_s: a goal is aborted when the reference had to wait for this duration.
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
