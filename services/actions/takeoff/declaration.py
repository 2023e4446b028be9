"""Declaration of the action `takeoff`."""

from jezero.schemas.topics import TAKEOFF
from jezero.services.actions.lifecycle.declaration import ActionDeclaration
from jezero.services.actions.takeoff.config import TakeoffConfig
from jezero.services.actions.takeoff.planner import TakeoffPlanner

ACTION = ActionDeclaration(action=TAKEOFF, settings=TakeoffConfig, planner=TakeoffPlanner)
