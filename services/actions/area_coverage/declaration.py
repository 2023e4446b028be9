"""Declaration of the action `area_coverage`."""

from jezero.schemas.topics import AREA_COVERAGE
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.area_coverage.planner import AreaCoveragePlanner
from jezero.services.actions.lifecycle.declaration import ActionDeclaration

ACTION = ActionDeclaration(action=AREA_COVERAGE, settings=AreaCoverageConfig, planner=AreaCoveragePlanner)
