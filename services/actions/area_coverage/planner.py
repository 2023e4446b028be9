"""The action `area_coverage`: plans coverages in a process of its own, before their goals are accepted.

The newest plans are kept, so that exactly the plan that a client has looked at is flown.
"""

import hashlib
from collections.abc import Callable, Sequence
from functools import partial
from math import dist, hypot
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from msgspec.structs import replace

from jezero.base.frames import Vec3, ned_from_geodetic, subtract
from jezero.schemas.actions import PlannedCoverage
from jezero.schemas.goals import AreaCoverageGoal, ImagesFeedback
from jezero.schemas.state import Status
from jezero.schemas.topics import RELATIVE
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.area_coverage.behaviour import AreaCoverage, frame_loss, frame_origin_ned_m
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan, Preparation, Prepared, Refusal, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.limits import point_refusal, speed_refusal

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


def _id_of(goal: AreaCoverageGoal, plan: "CoveragePlan") -> str:
    """Id of a plan: the same goal with the same path has the same id."""
    content = hashlib.sha256(msgspec.json.encode(_essence(goal)))
    for part in (plan.trajectory.t_s, plan.trajectory.pos_m, plan.pictures_m):
        content.update(part.tobytes())
    return content.hexdigest()[:ID_DIGITS]


TOO_LONG = "take fewer corners or holes, a coarser resolution, or map the area in parts"
MOVED_MAX_M = 5.0
"""Greatest horizontal distance of the vehicle from where it was at the planning, for a plan that is flown by its id:
the way to the begin of the path, with its time and battery, would be another than the one that was shown."""
ORIGINS_APART_MAX_M = 1.0
"""Greatest horizontal distance between the origin around which an area in degrees became metres, and that of the
vehicle: the whole flight would be elsewhere by this distance. GNSS itself is less exact."""


class AreaCoveragePlanner:
    """Plans coverages within the limits, and keeps the newest plans for goals that name one."""

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config
        self._shown = ShownPlans()

    def plan(self, goal: AreaCoverageGoal, status: Status) -> Plan | Refusal:
        """Plan a coverage; the preparation finds its path, unless the goal names a plan that was made before."""
        limits = self._config.vehicle.limits
        if reason := point_refusal((0.0, 0.0, goal.z_ned_m), limits) or speed_refusal(goal.speed_mps, limits):
            return Refusal(reason)
        if reason := _origin_refusal(goal, status):
            return Refusal(reason)
        shown = self._shown.find(goal, status) if goal.plan_id else None
        if isinstance(shown, Refusal):
            return shown
        capture = Capture(self._config.capture, self._config.vehicle.airframe, planned=0)
        made = None if shown is None else self._prepared(goal, capture, shown)
        return Plan(
            self._preparation(goal, status, capture) if made is None else made.start,
            warning="" if made is None else made.warning,
            coverage=None if made is None else made.coverage,
            inputs=(RELATIVE,) if goal.frame == "rover" else (),
            capture=capture,
            rate_hz=self._config.tracking.rate_hz,
            check_inputs=partial(_inputs_refusal, goal, capture, shown),
        )

    def replan(self, goal: AreaCoverageGoal, status: Status, running: AreaCoverage) -> Plan | Refusal:
        """Plan the rest of a coverage under way, with its missing pictures, or with those of another area."""
        rest = running.changed(goal)
        if isinstance(rest, Refusal):
            return rest
        limits = self._config.vehicle.limits
        if reason := point_refusal((0.0, 0.0, rest.z_ned_m), limits) or speed_refusal(rest.speed_mps, limits):
            return Refusal(reason)
        capture, index = running.capture, running.next_index
        preparation = Preparation(
            work=partial(self._work, rest),
            start=partial(
                self._prepared,
                rest,
                capture,
                first_index=index,
                taken_before=capture.taken,
                asked=(goal, running.asked[1]),
            ),
            too_long=TOO_LONG,
        )
        return Plan(preparation, capture=capture, rate_hz=self._config.tracking.rate_hz)

    def _preparation(self, goal: AreaCoverageGoal, status: Status, capture: Capture) -> Preparation:
        """Planning of the path, which takes up to some seconds."""

        def start(made: ShownPlan) -> Prepared:
            self._shown.add(goal, status, made)
            return self._prepared(goal, capture, made)

        return Preparation(
            work=partial(self._work, goal),
            start=start,
            feedback=partial(_feedback, goal),
            too_long=TOO_LONG,
        )

    def _work(self, goal: AreaCoverageGoal, state: VehicleState) -> Callable[[], ShownPlan | Refusal]:
        return partial(plan_or_refuse, goal, self._config, _position_m(goal, state), frame_origin_ned_m(goal, state))

    def _prepared(
        self,
        goal: AreaCoverageGoal,
        capture: Capture,
        made: ShownPlan,
        *,
        first_index: int | None = None,
        taken_before: int = 0,
        asked: tuple[AreaCoverageGoal, Vec3] | None = None,
    ) -> Prepared:
        first_index = made.plan.first_picture if first_index is None else first_index
        start = partial(AreaCoverage, goal, made.plan, capture, self._config, first_index, taken_before, asked)
        return Prepared(start, warning=made.plan.warning, coverage=made.shown)


def plan_or_refuse(
    goal: AreaCoverageGoal, config: ActionsConfig, start_m: tuple[float, float], origin_ned_m: Vec3
) -> ShownPlan | Refusal:
    """Plan a coverage, see `plan_coverage`; an area that can't be mapped is a refusal."""
    from jezero.services.actions.area_coverage.area import AreaError
    from jezero.services.actions.area_coverage.coverage_plan import plan_coverage

    try:
        plan = plan_coverage(goal, config, start_m, origin_ned_m)
    except AreaError as error:
        return Refusal(str(error))
    return ShownPlan(plan, describe(goal, plan))


def _origin_refusal(goal: AreaCoverageGoal, status: Status) -> str:
    """Reason why an area in degrees would be flown at another place than the client placed it, or ""."""
    if goal.origin_deg is None or goal.frame != "world":
        return ""
    origin_deg = None if status.odometry is None else status.odometry.origin_deg
    if origin_deg is None:
        return (
            "the area is in degrees, and the vehicle's autopilot has not sent its origin yet: wait until `jezero "
            "status` shows it, or give the area in metres without origin_deg"
        )
    apart_m = hypot(*ned_from_geodetic((*goal.origin_deg, origin_deg[2]), origin_deg)[:2])
    if apart_m <= ORIGINS_APART_MAX_M:
        return ""
    return (
        f"the area was placed around the origin {_degrees(goal.origin_deg)}, and the vehicle's is at "
        f"{_degrees(origin_deg)}, {apart_m:.3g} m away: place it again around the vehicle's origin, which `jezero "
        "status` shows"
    )


def _degrees(position_deg: Sequence[float]) -> str:
    return f"{position_deg[0]:.7f}, {position_deg[1]:.7f}"


def _inputs_refusal(goal: AreaCoverageGoal, capture: Capture, shown: ShownPlan | None, state: VehicleState) -> str:
    """Reason why the goal can't start with these inputs, or ""."""
    if reason := capture.refusal() or frame_loss(goal, state):
        return reason
    if shown is None or shown.plan.vehicle_m is None:
        return ""
    moved_m = dist(_position_m(goal, state), shown.plan.vehicle_m)
    if moved_m <= MOVED_MAX_M:
        return ""
    return (
        f"the vehicle is {moved_m:.0f} m away from where it was when plan {goal.plan_id} was made, more than "
        f"{MOVED_MAX_M:g} m: request the plan again"
    )


def _position_m(goal: AreaCoverageGoal, state: VehicleState) -> tuple[float, float]:
    """(2,) the vehicle's position in the goal's frame."""
    north_m, east_m, _ = subtract(state.pos_uav_ned_m, frame_origin_ned_m(goal, state))
    return north_m, east_m


def _feedback(goal: AreaCoverageGoal, state: VehicleState) -> ImagesFeedback:
    """Feedback while the path is being planned."""
    pos_ned_m = subtract(state.pos_uav_ned_m, frame_origin_ned_m(goal, state))
    return ImagesFeedback(pos_uav_ned_m=pos_ned_m, frame=goal.frame, phase="planning", taken=0, planned=0)
