"""The table of all actions."""

from dataclasses import replace
from typing import Any

import msgspec

from jezero.base.config import ConfigError, config_directory, load_config
from jezero.base.plugins import PluginError, load_declaration
from jezero.services.actions.area_coverage.planner import ACTION as AREA_COVERAGE
from jezero.services.actions.config import ActionsConfig, load_actions_config
from jezero.services.actions.get_images.planner import ACTION as GET_IMAGES
from jezero.services.actions.go_to import ACTION as GO_TO
from jezero.services.actions.land_on_spot.planner import ACTION as LAND_ON_SPOT
from jezero.services.actions.lifecycle.declaration import ActionDeclaration
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.return_home.behaviour import ACTION as RETURN_HOME
from jezero.services.actions.takeoff import ACTION as TAKEOFF

DECLARATIONS: dict[str, ActionDeclaration[Any]] = {
    declaration.name: declaration
    for declaration in (TAKEOFF, GO_TO, GET_IMAGES, LAND_ON_SPOT, AREA_COVERAGE, RETURN_HOME)
}
"""Declarations of jezero's own actions by name; `find_declaration` also finds those of packages."""


def find_declaration(name: str) -> ActionDeclaration[Any]:
    """The declaration of one of jezero's own actions, or of one that an installed package adds.

    Raises:
        PluginError: there is none, or its package is broken.
    """
    if name in DECLARATIONS:
        return DECLARATIONS[name]
    declaration = load_declaration(name)
    if not isinstance(declaration, ActionDeclaration):
        raise PluginError(
            f"action {name!r}: its entry point is a {type(declaration).__name__}, not an ActionDeclaration"
        )
    return declaration


def settings_of(declaration: ActionDeclaration[Any], config: ActionsConfig) -> Any:
    """An action's own settings: a table of `actions.toml`, or for an action of a package `<name>.toml` beside it.

    Raises:
        ConfigError: the settings are wrong.
    """
    if declaration.name in DECLARATIONS:
        return getattr(config, declaration.name)
    written = (config_directory() / f"{declaration.name}.toml").is_file()
    return load_config(declaration.settings, declaration.name) if written else declaration.settings()


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
        settings: own settings of an action of a package, by name; None: those of `settings_of`.

    Raises:
        PluginError: there is no such action, or the package that adds it is broken.
        ConfigError: the settings are wrong.
    """
    config = config or load_actions_config()
    declaration = find_declaration(name)
    if settings is None:
        own = settings_of(declaration, config)
    else:
        try:
            own = msgspec.convert(settings, declaration.settings)
        except msgspec.ValidationError as error:
            raise ConfigError(f"{name}: {error}") from None
    server = ActionServer(declaration.action, declaration.planner(own, config), config, boot_id, pictures)
    if name not in DECLARATIONS:  # the settings of jezero's own actions are in `config`
        server.spec = replace(server.spec, made_with={**server.spec.made_with, "settings": own})
    return server
