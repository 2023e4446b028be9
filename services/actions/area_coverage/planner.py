"""Plans coverages of an area; a process of its own works out the path, before the goal is accepted."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from jezero.frames import Vec3, subtract
from jezero.schemas.actions import AreaCoverageGoal, ImagesFeedback
from jezero.schemas.state import Status
from jezero.schemas.topics import RELATIVE
from jezero.services.actions.area_coverage.behaviour import AreaCoverage, frame_loss, frame_origin_ned_m
from jezero.services.actions.area_coverage.config import AreaCoverageConfig
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan, Preparation, Prepared, Refusal, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.limits import point_refusal, speed_refusal

if TYPE_CHECKING:
    from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan


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
            Preparation(
                work=partial(self._work, goal),
                start=partial(self._start, goal, capture),
                feedback=partial(_feedback, goal),
                too_long="take fewer corners or holes, a coarser resolution, or map the area in parts",
            ),
            inputs=(RELATIVE,) if goal.frame == "rover" else (),
            capture=capture,
            rate_hz=self._config.tracking.rate_hz,
            check_inputs=lambda state: capture.refusal() or frame_loss(goal, state),
        )

    def _work(self, goal: AreaCoverageGoal, state: VehicleState) -> "Callable[[], CoveragePlan | Refusal]":
        """The function that plans the path, which takes up to some seconds."""
        origin_ned_m = frame_origin_ned_m(goal, state)
        north_m, east_m, _ = subtract(state.pos_uav_ned_m, origin_ned_m)
        return partial(plan_or_refuse, goal, self._config, (north_m, east_m), origin_ned_m)

    def _start(self, goal: AreaCoverageGoal, capture: Capture, plan: "CoveragePlan") -> Prepared:
        return Prepared(partial(AreaCoverage, goal, plan, capture, self._config), warning=plan.warning)


def plan_or_refuse(
    goal: AreaCoverageGoal, config: ActionsConfig, start_m: tuple[float, float], origin_ned_m: Vec3
) -> "CoveragePlan | Refusal":
    """Plan a coverage, see `plan_coverage`; an area that can't be mapped is a refusal."""
    from jezero.services.actions.area_coverage.area import AreaError
    from jezero.services.actions.area_coverage.coverage_plan import plan_coverage

    try:
        return plan_coverage(goal, config, start_m, origin_ned_m)
    except AreaError as error:
        return Refusal(str(error))


def _feedback(goal: AreaCoverageGoal, state: VehicleState) -> ImagesFeedback:
    """Feedback while the path is being planned."""
    pos_ned_m = subtract(state.pos_uav_ned_m, frame_origin_ned_m(goal, state))
    return ImagesFeedback(pos_uav_ned_m=pos_ned_m, frame=goal.frame, phase="planning", taken=0, planned=0)
