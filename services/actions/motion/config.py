"""Settings that several actions share: straight flights, tracking of a moving reference."""

from typing import Annotated

from msgspec import Meta

from jezero.base.config import Config

Positive = Annotated[float, Meta(gt=0.0, le=1e4)]


class MoveConfig(Config, frozen=True, kw_only=True):
    """Motion of the reference point along a straight path, and the test of arrival at its end.

    The vehicle has arrived when it has been near the end and slow for `reached_s`. In wind it has also arrived when it
    has hovered about the end for 4 s: its mean position within twice `reached_m`, and never farther away than
    `reached_in_wind_m` or faster than `reached_in_wind_mps`. Above 6 m/s these three limits grow in proportion to the
    estimated wind, gusts included.

    Attributes:
        accel_mps2: acceleration and deceleration of the reference.
        speed_up_mps: maximum speed of the reference upwards.
        speed_down_mps: maximum speed of the reference downwards.
        yaw_rate_rps: rate at which the heading setpoint turns.
        reached_m: distance from the end below which the vehicle is near.
        reached_mps: speed below which the vehicle is slow.
        reached_s: time for which the vehicle must be near and slow.
        reached_in_wind_m: greatest distance from the end during a hover that counts as an arrival.
        reached_in_wind_mps: greatest speed during such a hover.
    """

    accel_mps2: Positive = 1.0
    speed_up_mps: Positive = 1.5
    speed_down_mps: Positive = 1.0
    yaw_rate_rps: Positive = 0.8
    reached_m: Positive = 0.15
    reached_mps: Positive = 0.2
    reached_s: Positive = 1.0
    reached_in_wind_m: Positive = 1.0
    reached_in_wind_mps: Positive = 1.0


class TrackingConfig(Config, frozen=True, kw_only=True):
    """Tracking of a moving reference with velocity setpoints.

    Attributes:
        rate_hz: setpoints per second.
        gain_1ps: velocity per position error.
        gain_integral_1ps2: velocity per integrated position error.
        gain_derivative: velocity per velocity error.
        acceleration_max_mps2: limit of the acceleration that is fed forward.
    """

    rate_hz: Positive = 100.0
    gain_1ps: Positive = 2.5
    gain_integral_1ps2: Positive = 1.5
    gain_derivative: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.2
    acceleration_max_mps2: Positive = 3.0


class CaptureConfig(Config, frozen=True, kw_only=True):
    """Capture of images.

    Attributes:
        late_max_s: maximum delay between a planned point and its image; a goal whose image is later is aborted.
    """

    late_max_s: Positive = 2.0
