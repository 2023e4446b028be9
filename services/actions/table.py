"""The table of all actions."""

from typing import Any

from jezero.runtime.config import load_config
from jezero.services.actions.area_coverage.declaration import ACTION as AREA_COVERAGE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.declaration import ACTION as GET_IMAGES
from jezero.services.actions.go_to.declaration import ACTION as GO_TO
from jezero.services.actions.land_on_spot.declaration import ACTION as LAND_ON_SPOT
from jezero.services.actions.lifecycle.declaration import ActionDeclaration
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.takeoff.declaration import ACTION as TAKEOFF

DECLARATIONS: dict[str, ActionDeclaration[Any]] = {
    declaration.name: declaration for declaration in (TAKEOFF, GO_TO, GET_IMAGES, LAND_ON_SPOT, AREA_COVERAGE)
}
"""Declarations of all actions by name."""


def action_server(
    name: str, boot_id: int, config: ActionsConfig | None = None, pictures: PictureStore | None = None
) -> ActionServer:
    """Make the server of the action `name`; settings from `actions.toml` unless given.

    Args:
        boot_id: see `ActionServer`.
        pictures: see `ActionServer`.

    Raises:
        KeyError: there is no such action.
        ConfigError: the settings are wrong.
    """
    config = config or load_config(ActionsConfig, "actions")
    declaration = DECLARATIONS[name]
    planner = declaration.planner(getattr(config, name), config)
    return ActionServer(declaration.action, planner, config, boot_id, pictures)
