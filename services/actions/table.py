"""Which behaviour carries out which action."""

from collections.abc import Callable

from jezero.schemas.topics import ACTIONS
from jezero.services.actions.behaviour import Behaviour
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.go_to import GoTo
from jezero.services.actions.land_on_spot import LandOnSpot
from jezero.services.actions.server import ActionServer
from jezero.services.actions.takeoff import Takeoff

BEHAVIOURS: dict[str, Callable[[ActionsConfig], Behaviour]] = {
    "takeoff": Takeoff,
    "go_to": GoTo,
    "land_on_spot": LandOnSpot,
}


def action_server(name: str, config: ActionsConfig, boot_id: int) -> ActionServer:
    """The server of the action of that name.

    Raises:
        KeyError: there is none.
    """
    return ActionServer(ACTIONS[name], BEHAVIOURS[name], config, boot_id)
