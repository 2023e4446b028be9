"""A stack whose mission service keeps its mission as a process does, with a record of its progress."""

from typing import Any

import msgspec

from jezero.base.config import load_config
from jezero.base.plugins import all_actions
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.mission import FailurePolicy, GoalStep, Mission, MissionCommand, MissionProgress, MissionReply
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.mission.config import MissionConfig
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.service import MissionService
from jezero.services.simulator.camera.config import CameraConfig
from jezero.trials.stack import BlankCamera, build_stack
from tests.scenario.rig import Flight

TAKEOFF = GoalStep(label="take off", action="takeoff", goal={"altitude_m": 2.0})
LAND = GoalStep(label="land", action="land_on_spot", goal={})


def go(north_m: float, east_m: float, down_m: float = -3.0, **policy: Any) -> GoalStep:
    goal = {"target_ned_m": [north_m, east_m, down_m]}
    return GoalStep(
        label=f"go to {north_m:g} {east_m:g}", action="go_to", goal=goal, on_failure=FailurePolicy(**policy)
    )


class MissionFlight(Flight):
    """A stack with a camera of small grey images, whose mission service keeps its mission as a process does."""

    def __init__(
        self,
        autopilot: AutopilotConfig | None = None,
        config: MissionConfig | None = None,
        vehicle: VehicleConfig | None = None,
        saved: MissionRecord | None = None,
    ) -> None:
        self._vehicle = vehicle or load_config(VehicleConfig, "vehicle")
        self._autopilot = autopilot
        self._config = config
        self.saved = [] if saved is None else [saved]
        self.progress: list[MissionProgress] = []
        super().__init__(1, self._make)
        self.bus.observe(self._on_message)

    def _make(self, seed: int) -> MemoryBus:
        bus = build_stack(seed, autopilot=self._autopilot, vehicle=self._vehicle, without=("mission",))
        bus.add(BlankCamera(load_config(CameraConfig, "camera"), self._vehicle.camera, publishes_info=False))
        bus.add(self.service(1))
        return bus

    def service(self, boot_id: int) -> MissionService:
        """A new process of the mission service."""
        saved = self.saved[-1] if self.saved else None
        return MissionService(
            boot_id, all_actions(), saved, self.saved.append, config=self._config, vehicle=self._vehicle
        )

    def _on_message(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.MISSION.name:
            self.progress.append(msgspec.json.decode(data, type=MissionProgress))

    def run(self, *steps: Any) -> MissionReply:
        reply = self.request(topics.RUN_MISSION, Mission(name="test", steps=steps))
        assert isinstance(reply, MissionReply)
        return reply

    def command(self, command: Any) -> MissionReply:
        reply = self.request(topics.COMMAND_MISSION, MissionCommand(command=command))
        assert isinstance(reply, MissionReply)
        return reply

    def wait_state(self, state: str, timeout_s: float = 120.0) -> MissionProgress:
        self.wait(lambda: bool(self.progress) and self.progress[-1].state == state, timeout_s, f"mission {state}")
        return self.progress[-1]

    def wait_step(self, step: int) -> None:
        self.wait(lambda: self.progress[-1].step == step and bool(self.progress[-1].goal_id), 60.0, f"step {step}")
