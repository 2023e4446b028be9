"""Declaration of the action `land_on_spot`."""

from jezero.schemas.topics import LAND_ON_SPOT
from jezero.services.actions.land_on_spot.config import LandOnSpotConfig
from jezero.services.actions.land_on_spot.planner import LandOnSpotPlanner
from jezero.services.actions.lifecycle.declaration import ActionDeclaration

ACTION = ActionDeclaration(action=LAND_ON_SPOT, settings=LandOnSpotConfig, planner=LandOnSpotPlanner)
