"""Settings of all action servers, which share one file because they have limits and ways of moving in common."""

from jezero.runtime.config import Config
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.go_to.config import GoToConfig
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig
from jezero.services.actions.lifecycle.config import CaptureConfig, LifecycleConfig
from jezero.services.actions.motion.config import LimitsConfig, MoveConfig, TrackingConfig
from jezero.services.actions.takeoff.config import TakeoffConfig


class ActionsConfig(Config, frozen=True, kw_only=True):
    """The tables of `deploy/config/actions.toml`."""

    limits: LimitsConfig = LimitsConfig()
    lifecycle: LifecycleConfig = LifecycleConfig()
    capture: CaptureConfig = CaptureConfig()
    move: MoveConfig = MoveConfig()
    tracking: TrackingConfig = TrackingConfig()
    takeoff: TakeoffConfig = TakeoffConfig()
    go_to: GoToConfig = GoToConfig()
    get_images: GetImagesConfig = GetImagesConfig()
    area_coverage: AreaCoverageConfig = AreaCoverageConfig()
    land_on_spot: LandOnSpotConfig = LandOnSpotConfig()
