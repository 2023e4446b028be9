"""The action `get_images`: plans flights around a target, and refuses those that can't be flown."""

from functools import partial
from math import hypot, sqrt

from jezero.base.frames import Vec3, add
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.schemas.goals import GetImagesGoal
from jezero.schemas.state import Status
from jezero.schemas.topics import RELATIVE
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.get_images.behaviour import GetImages, Turn
from jezero.services.actions.motion.behaviour import Plan, Refusal, VehicleState
from jezero.services.actions.motion.capture import Capture
from jezero.services.actions.motion.limits import distance_refusal, high_or_far_refusal, point_refusal, speed_refusal
from jezero.services.actions.motion.rover_frame import loss_reason, rover_position

IMAGES_MAX = 255
EXPOSURES_PER_PICTURE = 2.0
"""The camera makes at least this number of exposures between two planned points."""


class GetImagesPlanner:
    """Plans one turn around a target within the limits."""

    def __init__(self, config: ActionsConfig) -> None:
        self._config = config

    def plan(self, goal: GetImagesGoal, status: Status) -> Plan | Refusal:
        """Plan the turn; its speed is lower than the goal's where the circle is small or has many pictures."""
        if reason := self._shape_refusal(goal):
            return Refusal(reason)
        capture = Capture(
            self._config.capture, self._config.vehicle.airframe, goal.num_images, stream=goal.stream_images
        )
        return self._plan(goal, Turn.begin(goal.num_images), capture)

    def replan(self, goal: GetImagesGoal, status: Status, running: GetImages) -> Plan | Refusal:
        """Plan the rest of the turn on the changed circle, with the pictures that are still missing."""
        if reason := self._shape_refusal(goal):
            return Refusal(reason)
        turn = running.turn
        if turn.requested == 0:
            return self._plan(goal, Turn.begin(goal.num_images), running.capture)
        if goal.num_images <= turn.requested:
            return Refusal(
                f"{turn.requested} pictures are taken already: ask for more than that, or cancel the goal, whose "
                "result has them"
            )
        return self._plan(goal, turn.with_images(goal.num_images), running.capture)

    def _shape_refusal(self, goal: GetImagesGoal) -> str:
        """Reason why no vehicle could fly the goal, with what to change, or ""."""
        settings, limits = self._config.get_images, self._config.vehicle.limits
        if not 1 <= goal.num_images <= IMAGES_MAX:
            return f"num_images {goal.num_images} is not within 1 to {IMAGES_MAX}"
        if not goal.radius_m >= settings.radius_min_m:
            least_m = settings.radius_min_m
            return f"radius {goal.radius_m:g} m is too small: the vehicle flies around at {least_m:g} m or more"
        if reason := point_refusal(goal.center_ned_m, limits):
            return reason.replace("target z", "the center's z")
        if goal.target_z_ned_m < goal.center_ned_m[2]:
            return (
                f"the target at z = {goal.target_z_ned_m:g} m is above the flight at {goal.center_ned_m[2]:g} m, and "
                "the camera looks down: fly higher, or give target_z_ned_m"
            )
        return far_refusal(goal.center_ned_m, goal.radius_m, limits) or speed_refusal(goal.speed_mps, limits)

    def _plan(self, goal: GetImagesGoal, turn: Turn, capture: Capture) -> Plan:
        wanted_mps = self._config.get_images.speed_mps if goal.speed_mps is None else goal.speed_mps
        speed_mps = min(wanted_mps, self._speed_max_mps(goal, turn))
        slower = (
            f"flown at {speed_mps:.2g} m/s instead of {wanted_mps:g} m/s: the circle is small, or has many pictures"
        )
        return Plan(
            partial(GetImages, goal, speed_mps, turn, capture, self._config),
            warning=slower if goal.speed_mps is not None and speed_mps < wanted_mps else "",
            inputs=(RELATIVE,) if goal.frame == "rover" else (),
            capture=capture,
            rate_hz=self._config.tracking.rate_hz,
            check_inputs=partial(self._inputs_refusal, goal, capture),
        )

    def _inputs_refusal(self, goal: GetImagesGoal, capture: Capture, state: VehicleState) -> str:
        """Reason why the goal can't start with these inputs, or ""."""
        if goal.frame == "rover":
            relative = state.relative
            if relative is None or not relative.valid:
                return loss_reason(relative)
            center_ned_m = add(goal.center_ned_m, rover_position(state, relative))
            limits = self._config.vehicle.limits
            if reason := high_or_far_refusal(center_ned_m, limits) or far_refusal(center_ned_m, goal.radius_m, limits):
                return reason
        return capture.refusal()

    def _speed_max_mps(self, goal: GetImagesGoal, turn: Turn) -> float:
        """Greatest speed that the circle's radius and the camera's rate allow."""
        rate_hz = self._config.vehicle.camera.rate_hz
        spacing_m = turn.spacing_min_rad * goal.radius_m
        tight_mps = sqrt(self._config.get_images.inwards_max_mps2 * goal.radius_m)
        return min(tight_mps, spacing_m * rate_hz / EXPOSURES_PER_PICTURE)


def far_refusal(center_ned_m: Vec3, radius_m: float, limits: VehicleLimitsConfig) -> str:
    """Reason why the circle's farthest point is too far away, or ""."""
    factor = 1.0 + radius_m / max(hypot(center_ned_m[0], center_ned_m[1]), 1e-9)
    if hypot(center_ned_m[0], center_ned_m[1]) < 1e-6:
        return distance_refusal((radius_m, 0.0, 0.0), limits)
    return distance_refusal((factor * center_ned_m[0], factor * center_ned_m[1], 0.0), limits)
