"""Settings of all action servers, which share one file because they move alike and fly the same vehicle."""

from msgspec.structs import replace

from jezero.runtime.config import Config, ConfigError, load_config
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.go_to.config import GoToConfig
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig
from jezero.services.actions.motion.config import CaptureConfig, MoveConfig, Positive, TrackingConfig
from jezero.services.actions.return_home.config import ReturnHomeConfig
from jezero.services.actions.takeoff.config import TakeoffConfig
from jezero.vehicle_config import VehicleConfig


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """Handling of a goal from its arrival to its result.

    Attributes:
        step_rate_hz: steps of the server per second while no trigger arrives.
    """

    step_rate_hz: Positive = 10.0


class ActionsConfig(Config, frozen=True, kw_only=True):
    """Tables of `deploy/config/actions.toml`, and the vehicle.

    Attributes:
        lifecycle: handling of goals.
        capture: capture of images.
        move: straight flights.
        tracking: tracking of a moving reference.
        takeoff: settings of the action `takeoff`.
        go_to: settings of the action `go_to`.
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
