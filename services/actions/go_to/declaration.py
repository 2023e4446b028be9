"""Declaration of the action `go_to`."""

from jezero.schemas.topics import GO_TO
from jezero.services.actions.go_to.config import GoToConfig
from jezero.services.actions.go_to.planner import GoToPlanner
from jezero.services.actions.lifecycle.declaration import ActionDeclaration

ACTION = ActionDeclaration(action=GO_TO, settings=GoToConfig, planner=GoToPlanner)
