"""Plans that clients have been shown, so that exactly the plan that was looked at is flown."""

import hashlib
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from msgspec.structs import replace

from jezero.schemas.actions import PlannedCoverage
from jezero.schemas.goals import AreaCoverageGoal
from jezero.schemas.state import Status
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import Refusal

if TYPE_CHECKING:
    from jezero.services.actions.area_coverage.coverage_plan import CoveragePlan

KEPT_S = 600.0
"""Age of the oldest plan that is flown: time to look at the drawing, and not so long that it is of another day."""
ID_DIGITS = 12
KEPT_MAX = 8
"""A plan of 3000 pictures takes up to ten megabytes."""
SIMPLIFIED_M = 0.01
"""Greatest distance of the path that clients are shown from the one that is flown."""


class ShownPlan(NamedTuple):
    """A plan, and its description for clients."""

    plan: "CoveragePlan"
    shown: PlannedCoverage


class _Kept(NamedTuple):
    goal: AreaCoverageGoal
    t_ns: int
    epoch_id: int
    plan: ShownPlan


class ShownPlans:
    """The newest plans of one server, by their ids."""

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}

    def add(self, goal: AreaCoverageGoal, status: Status, plan: ShownPlan) -> None:
        """Keep a plan that was made for a goal.

        Args:
            status: at the arrival of the request.
        """
        self._kept.pop(plan.shown.plan_id, None)
        self._kept[plan.shown.plan_id] = _Kept(_essence(goal), status.t_ns, status.epoch_id, plan)
        if len(self._kept) > KEPT_MAX:
            del self._kept[next(iter(self._kept))]

    def find(self, goal: AreaCoverageGoal, status: Status) -> ShownPlan | Refusal:
        """The plan that a goal names, or the reason why it can't be flown."""
        kept = self._kept.get(goal.plan_id)
        too_old = kept is not None and status.t_ns - kept.t_ns > KEPT_S * NS_PER_S
        if kept is None or too_old or kept.epoch_id != status.epoch_id:
            return Refusal(
                f"plan {goal.plan_id} is not known: it is older than {KEPT_S / 60.0:g} minutes, or the server or the "
                "vehicle restarted; request the plan again, or leave plan_id out"
            )
        if kept.goal != _essence(goal):
            return Refusal(f"plan {goal.plan_id} was made for a goal with other fields: request the plan of this goal")
        return kept.plan


def _id_of(goal: AreaCoverageGoal, plan: "CoveragePlan") -> str:
    """Id of a plan: the same goal with the same path has the same id."""
    content = hashlib.sha256(msgspec.json.encode(_essence(goal)))
    for part in (plan.trajectory.t_s, plan.trajectory.pos_m, plan.pictures_m):
        content.update(part.tobytes())
    return content.hexdigest()[:ID_DIGITS]


def _essence(goal: AreaCoverageGoal) -> AreaCoverageGoal:
    """What a plan depends on; its start is part of the plan."""
    return replace(goal, goal_id="", issued_t_ns=None, on_client_loss="continue", plan_id="", start_ned_m=None)


def describe(goal: AreaCoverageGoal, plan: "CoveragePlan") -> PlannedCoverage:
    """Description of a plan of a goal for clients."""
    import numpy as np
    from shapely.geometry import LineString

    path_m = np.array(LineString(plan.trajectory.pos_m).simplify(SIMPLIFIED_M).coords)
    return PlannedCoverage(
        plan_id=_id_of(goal, plan),
        path_ned_m=tuple(map(tuple, path_m.round(3).tolist())),
        pictures_ned_m=tuple(map(tuple, plan.pictures_m.round(3).tolist())),
        start_ned_m=plan.start_m,
        line_distance_m=plan.line_distance_m,
        picture_distance_m=plan.picture_distance_m,
        length_m=plan.trajectory.length_m,
        duration_s=plan.trajectory.duration_s,
        covered=min(plan.covered, 1.0),
        photographed=plan.photographs.fraction,
    )
