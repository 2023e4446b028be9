"""Declaration of the action `get_images`."""

from jezero.schemas.topics import GET_IMAGES
from jezero.services.actions.get_images.config import GetImagesConfig
from jezero.services.actions.get_images.planner import GetImagesPlanner
from jezero.services.actions.lifecycle.declaration import ActionDeclaration

ACTION = ActionDeclaration(action=GET_IMAGES, settings=GetImagesConfig, planner=GetImagesPlanner)
