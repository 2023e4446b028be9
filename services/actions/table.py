"""The table of all actions."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec

from jezero.base.config import ConfigError, config_directory, load_config
from jezero.base.plugins import PluginError, load_declaration
from jezero.schemas.topics import (
    ACTIONS,
    AREA_COVERAGE,
    FLY_VELOCITY,
    GET_IMAGES,
    GO_TO,
    LAND_ON_SPOT,
    RETURN_HOME,
    TAKEOFF,
)
from jezero.services.actions.area_coverage.planner import AreaCoveragePlanner
from jezero.services.actions.config import ActionsConfig, load_actions_config
from jezero.services.actions.fly_velocity.behaviour import FlyVelocityPlanner
from jezero.services.actions.get_images.planner import GetImagesPlanner
from jezero.services.actions.go_to import GoToPlanner
from jezero.services.actions.land_on_spot.planner import LandOnSpotPlanner
from jezero.services.actions.lifecycle.declaration import ActionDeclaration
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.motion.behaviour import Planner
from jezero.services.actions.return_home.behaviour import ReturnHomePlanner
from jezero.services.actions.takeoff import TakeoffPlanner

PLANNERS: dict[str, Callable[[ActionsConfig], Planner]] = {
    TAKEOFF.name: TakeoffPlanner,
    GO_TO.name: GoToPlanner,
    FLY_VELOCITY.name: FlyVelocityPlanner,
    GET_IMAGES.name: GetImagesPlanner,
    LAND_ON_SPOT.name: LandOnSpotPlanner,
    AREA_COVERAGE.name: AreaCoveragePlanner,
    RETURN_HOME.name: ReturnHomePlanner,
}
"""What makes the planner of each of jezero's own actions; an action of a package has it in its declaration."""


def action_server(
    name: str,
    boot_id: int,
    config: ActionsConfig | None = None,
    pictures: PictureStore | None = None,
    settings: dict[str, Any] | None = None,
) -> ActionServer:
    """Make the server of the action `name`; settings from `actions.toml` and `vehicle.toml` unless given.

    Args:
        boot_id: see `ActionServer`.
        pictures: see `ActionServer`.
        settings: own settings of an action of a package, by name; None: those of its file, `<name>.toml`.

    Raises:
        PluginError: there is no such action, or the package that adds it is broken.
        ConfigError: the settings are wrong.
    """
    config = config or load_actions_config()
    if name in PLANNERS:
        return ActionServer(ACTIONS[name], PLANNERS[name](config), config, boot_id, pictures)
    declaration = load_declaration(name)
    if not isinstance(declaration, ActionDeclaration):
        kind = type(declaration).__name__
        raise PluginError(f"action {name!r}: its entry point is a {kind}, not an ActionDeclaration")
    own = _own_settings(declaration, settings)
    server = ActionServer(declaration.action, declaration.planner(own, config), config, boot_id, pictures)
    server.spec = replace(server.spec, made_with={**server.spec.made_with, "settings": own})
    return server


def _own_settings(declaration: ActionDeclaration[Any], settings: dict[str, Any] | None) -> Any:
    """Settings of an action of a package, from its file beside `actions.toml` unless they are given."""
    name = declaration.action.name
    if settings is None:
        written = (config_directory() / f"{name}.toml").is_file()
        return load_config(declaration.settings, name) if written else declaration.settings()
    try:
        return msgspec.convert(settings, declaration.settings)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{name}: {error}") from None
