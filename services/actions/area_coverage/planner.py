"""Plans coverages of an area; the path over it is worked out in the background, before the goal is accepted."""

from collections.abc import Callable
from functools import partial

from jezero.frames import subtract
from jezero.schemas.actions import AreaCoverageGoal
from jezero.schemas.state import Status
from jezero.schemas.topics import RELATIVE
from jezero.services.actions.area_coverage.behaviour import AreaCoverage, frame_loss, frame_origin_ned_m
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan, Preparation, Refusal, Start, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.limits import point_refusal, speed_refusal


class AreaCoveragePlanner:
    """Plans coverages within the limits."""

    def __init__(self, settings: AreaCoverageConfig, config: ActionsConfig) -> None:
        self._settings = settings
        self._config = config

    def plan(self, goal: AreaCoverageGoal, status: Status) -> Plan | Refusal:
        """Plan a coverage; the preparation finds its path."""
        limits = self._config.vehicle.limits
        if reason := point_refusal((0.0, 0.0, goal.z_ned_m), limits) or speed_refusal(goal.speed_mps, limits):
            return Refusal(reason)
        capture = Capture(self._config.capture, self._config.vehicle, planned=0)
        return Plan(
            Preparation(partial(self._prepare, goal, capture)),
            inputs=(RELATIVE,) if goal.frame == "rover" else (),
            capture=capture,
            rate_hz=self._config.tracking.rate_hz,
            check_inputs=lambda state: capture.refusal() or frame_loss(goal, state),
        )

    def _prepare(self, goal: AreaCoverageGoal, capture: Capture, state: VehicleState) -> Callable[[], Start | Refusal]:
        """A function that plans the path, which takes up to a second."""
        config = self._config
        origin_ned_m = frame_origin_ned_m(goal, state)
        north_m, east_m, _ = subtract(state.pos_uav_ned_m, origin_ned_m)

        def make_plan() -> Start | Refusal:
            from jezero.services.actions.area_coverage.area import AreaError
            from jezero.services.actions.area_coverage.coverage_plan import plan_coverage

            try:
                plan = plan_coverage(goal, config, (north_m, east_m), origin_ned_m)
            except AreaError as error:
                return Refusal(str(error))
            return partial(AreaCoverage, goal, plan, capture, config)

        return make_plan
