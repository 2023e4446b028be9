"""Plans without a running stack: the action servers plan in a stack in virtual time, in this process."""

from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from jezero.base.codec import decode
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas import topics
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import Goal, TakeoffGoal
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.stack import BlankCamera, build_stack

READY_TIMEOUT_S = 60.0
PLAN_TIMEOUT_S = 120.0
PAUSE_S = 0.1
"""Time before a plan in which the action server is over with the one before."""
LOOK_M = 3.0
SETTLE_S = 1.0
"""Time after the first ready status, in which every action server has heard of it."""


class VirtualPlanner:
    """A stack that plans goals; its vehicle has taken off, so that UWB has found the rover.

    Args:
        origin_deg: latitude, longitude and perhaps altitude of the world's origin; the simulator's without.

    Raises:
        ConfigError: a configuration file is invalid.
    """

    def __init__(self, origin_deg: Sequence[float] = ()) -> None:
        simulator, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
        names = ("latitude_deg", "longitude_deg", "altitude_m")
        origin = replace(simulator.origin, **dict(zip(names, origin_deg, strict=False)))
        simulator = replace(simulator, origin=origin, uav=replace(simulator.uav, start="ground"))
        self._bus = build_stack(1, simulator=simulator, vehicle=vehicle, without=("camera",))
        self._bus.add(BlankCamera(load_config(CameraConfig, "camera"), vehicle.camera, publishes_info=True))
        self._status: Status | None = None
        self._bus.observe(self._observe)
        self._bus.run_for(READY_TIMEOUT_S, lambda: self._status is not None and self._status.ready)
        self._bus.run_for(SETTLE_S)
        takeoff = self._bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(goal_id="look", altitude_m=LOOK_M))
        self._bus.run_for(PLAN_TIMEOUT_S, lambda: takeoff.ended)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.STATUS.name:
            self._status = decode(Status, data)

    def plan(self, action: Action[Any], goal: Goal) -> PlanReply:
        """Plan a goal, as `Vehicle.plan` does; a refusal is a reply too."""
        self._bus.run_for(PAUSE_S)
        sent = self._bus.send_request(action.plan, goal)
        self._bus.run_for(PLAN_TIMEOUT_S, lambda: sent.ended)
        if not sent.replies:
            return PlanReply(accepted=False, reason="it took too long to plan", input_missing=True)
        reply: PlanReply = sent.replies[0]
        return reply
