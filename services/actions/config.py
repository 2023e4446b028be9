"""Settings of all action servers, which share one file because they move alike and fly the same vehicle."""

from typing import Annotated

from msgspec import Meta
from msgspec.structs import replace

from jezero.base.config import Config, ConfigError, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.fly_velocity.config import FlyVelocityConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig
from jezero.services.actions.motion.config import CaptureConfig, MoveConfig, Positive, TrackingConfig


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """Handling of a goal from its arrival to its result.

    Attributes:
        step_rate_hz: steps of the server per second while no trigger arrives.
    """

    step_rate_hz: Positive = 10.0


class TakeoffConfig(Config, frozen=True, kw_only=True):
    """Climb straight up from the ground: its speed is in `move`, its least altitude in the limits of `vehicle.toml`."""


class GoToConfig(Config, frozen=True, kw_only=True):
    """Straight flight to a target.

    Attributes:
        speed_mps: speed for a goal without `speed_mps`, and on the way to a circle or an area.
        takeoff_altitude_m: altitude of the takeoff with `do_takeoff`, above the take-off point.
    """

    speed_mps: Positive = 2.0
    takeoff_altitude_m: Positive = 2.0


Horizontal = Annotated[float, Meta(ge=-1e4, le=1e4)]


class ReturnHomeConfig(Config, frozen=True, kw_only=True):
    """The way home, and the places at which it may end.

    Attributes:
        safe_height_m: height above the world's origin at which the vehicle flies home, if it isn't higher.
        near_m: horizontal distance from the place below which the vehicle does not climb first.
        speed_mps: speed on the way.
        height_arrival_m: height over the place to which the vehicle descends before the landing begins; UWB, camera and
            altimeter find the rover from there.
        rover_std_max_m: standard deviation of the rover's position up to which the vehicle flies there and searches,
            while the rover is out of sight.
        rally_points_ned_m: north and east of places on the ground where the vehicle may land.
    """

    safe_height_m: Positive = 10.0
    near_m: Positive = 5.0
    speed_mps: Positive = 4.0
    height_arrival_m: Positive = 6.0
    rover_std_max_m: Positive = 10.0
    rally_points_ned_m: Annotated[tuple[tuple[Horizontal, Horizontal], ...], Meta(max_length=100)] = ()


class ActionsConfig(Config, frozen=True, kw_only=True):
    """Tables of `deploy/config/actions.toml`, and the vehicle.

    Attributes:
        lifecycle: handling of goals.
        capture: capture of images.
        move: straight flights.
        tracking: tracking of a moving reference.
        takeoff: settings of the action `takeoff`.
        go_to: settings of the action `go_to`.
        fly_velocity: settings of the action `fly_velocity`.
        get_images: settings of the action `get_images`.
        area_coverage: settings of the action `area_coverage`.
        land_on_spot: settings of the action `land_on_spot`.
        return_home: settings of the action `return_home`.
        vehicle: the vehicle itself, with the limits of every goal; from `vehicle.toml`, no table of `actions.toml`.
    """

    lifecycle: LifecycleConfig = LifecycleConfig()
    capture: CaptureConfig = CaptureConfig()
    move: MoveConfig = MoveConfig()
    tracking: TrackingConfig = TrackingConfig()
    takeoff: TakeoffConfig = TakeoffConfig()
    go_to: GoToConfig = GoToConfig()
    fly_velocity: FlyVelocityConfig = FlyVelocityConfig()
    get_images: GetImagesConfig = GetImagesConfig()
    area_coverage: AreaCoverageConfig = AreaCoverageConfig()
    land_on_spot: LandOnSpotConfig = LandOnSpotConfig()
    return_home: ReturnHomeConfig = ReturnHomeConfig()
    vehicle: VehicleConfig = VehicleConfig()


def load_actions_config(vehicle: VehicleConfig | None = None) -> ActionsConfig:
    """Read `actions.toml`.

    Args:
        vehicle: the vehicle; None reads `vehicle.toml`.

    Raises:
        ConfigError: a file is missing or malformed, or `actions.toml` describes the vehicle.
    """
    config = load_config(ActionsConfig, "actions")
    if config.vehicle != VehicleConfig():
        raise ConfigError("actions.toml has a table [vehicle]: what the vehicle is belongs in vehicle.toml")
    return replace(config, vehicle=vehicle or load_config(VehicleConfig, "vehicle"))
