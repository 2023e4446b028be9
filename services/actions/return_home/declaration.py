"""Declaration of the action `return_home`."""

from jezero.schemas.topics import RETURN_HOME
from jezero.services.actions.lifecycle.declaration import ActionDeclaration
from jezero.services.actions.return_home.config import ReturnHomeConfig
from jezero.services.actions.return_home.planner import ReturnHomePlanner

ACTION = ActionDeclaration(action=RETURN_HOME, settings=ReturnHomeConfig, planner=ReturnHomePlanner)
