"""Which behaviour carries out which action."""

from collections.abc import Callable

from jezero.runtime.config import load_config
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.area_coverage.behaviour import AreaCoverage
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.behaviour import GetImages
from jezero.services.actions.go_to.behaviour import GoTo
from jezero.services.actions.land_on_spot.behaviour import LandOnSpot
from jezero.services.actions.lifecycle.behaviour import Behaviour
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.takeoff.behaviour import Takeoff

BEHAVIOURS: dict[str, Callable[[ActionsConfig], Behaviour]] = {
    "takeoff": Takeoff,
    "go_to": GoTo,
    "get_images": GetImages,
    "land_on_spot": LandOnSpot,
    "area_coverage": AreaCoverage,
}


def action_server(
    name: str, boot_id: int, config: ActionsConfig | None = None, spool: PictureStore | None = None
) -> ActionServer:
    """The server of the action of that name; settings from `actions.toml` unless given.

    Args:
        spool: see `ActionServer`.

    Raises:
        KeyError: there is no such action.
        ConfigError: the settings are wrong.
    """
    config = config or load_config(ActionsConfig, "actions")
    return ActionServer(ACTIONS[name], BEHAVIOURS[name], config, boot_id, spool)
