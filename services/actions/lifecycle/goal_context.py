"""What a goal needs from its arrival to its result."""

from dataclasses import dataclass, field
from typing import Any

from jezero.schemas.rows import Action, Topic
from jezero.services.actions.lifecycle.selection_lease import SelectionLease
from jezero.services.actions.lifecycle.vehicle_view import VehicleView
from jezero.services.actions.motion.behaviour import Plan
from jezero.vehicle_config import VehicleConfig


@dataclass(frozen=True, kw_only=True)
class GoalContext:
    """One goal with what it needs from its arrival to its result.

    Attributes:
        action: that the goal is for.
        goal_id: its id.
        plan: its plan.
        inputs: topics that it subscribes to besides odometry.
        view: state of the vehicle for this goal.
        lease: its own selection of the estimator's inputs; None: it has none.
        vehicle: has the limits of the goal's points.
        epoch_id: of the vehicle that the goal is for.
        acceleration_mps2: with which a pause brakes.
        watchers: ids of the requests that get replies.
    """

    action: Action[Any]
    goal_id: str
    plan: Plan
    inputs: tuple[Topic[Any], ...]
    view: VehicleView
    lease: SelectionLease | None
    vehicle: VehicleConfig
    epoch_id: int
    acceleration_mps2: float
    watchers: list[int] = field(default_factory=list)
