"""A coverage in virtual time, in 3 m/s mean wind with gusts of 0.6 m/s, with the records to evaluate it."""

from pathlib import Path
from typing import Any, cast

import msgspec

from benchmarks.quality.orbit import WIND, Black
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.client.dataset import Dataset
from jezero.client.images import Picture
from jezero.runtime.memory_bus import SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Result
from jezero.schemas.commands import Phase, Setpoint
from jezero.schemas.goals import AreaCoverageGoal, CoverageResult, TakeoffGoal
from jezero.schemas.images import GetImage
from jezero.schemas.state import Odometry, Status, Truth
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.service import CameraSimulator
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.stack import boot_id, service_makers, wired_bus

NOT_NEEDED = ("tag_detector", "go_to", "land_on_spot")
WATCHED: dict[str, Any] = {
    topic.name: topic.type for topic in (topics.ODOMETRY, topics.TRUTH, topics.STATUS, topics.SETPOINT)
}


class Covering:
    """A vehicle that takes off and maps an area.

    Args:
        rendered: whether pictures show the simulated world; else they are black.

    Attributes:
        odometry: odometry of the whole flight.
        truths: truth of the whole flight.
        bus: the bus of the stack.
        mapping_ns: first and last time of a setpoint on the path.
        status: the newest status.
    """

    def __init__(self, seed: int, *, rendered: bool, simulator: SimulatorConfig | None = None) -> None:
        simulator = msgspec.structs.replace(simulator or load_config(SimulatorConfig, "simulator"), wind=WIND)
        camera = msgspec.structs.replace(load_config(CameraConfig, "camera"), mode="rendered")
        makers = service_makers(seed, simulator=simulator, camera=camera)
        if not rendered:
            vehicle = load_config(VehicleConfig, "vehicle")
            makers["camera"] = lambda boot: CameraSimulator(camera, vehicle, Black(vehicle.camera), seed)
        self.bus = wired_bus(seed)
        for name, make in makers.items():
            if name not in NOT_NEEDED:
                self.bus.add(make(boot_id(seed, name)))
        self.odometry: list[Odometry] = []
        self.truths: list[Truth] = []
        self.mapping_ns: tuple[int, int] | None = None
        self.status: Status | None = None
        self.bus.observe(self._observe)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic not in WATCHED:
            return
        message = msgspec.json.decode(data, type=WATCHED[topic])
        if isinstance(message, Odometry):
            self.odometry.append(message)
        elif isinstance(message, Truth):
            self.truths.append(message)
        elif isinstance(message, Status):
            self.status = message
        elif isinstance(message, Setpoint) and message.phase is Phase.COVERAGE and message.pos_ned_m is None:
            self.mapping_ns = (self.mapping_ns[0] if self.mapping_ns else message.t_ns, message.t_ns)

    def fly(self, goal: AreaCoverageGoal) -> CoverageResult:
        """Take off and fly the goal.

        Raises:
            RuntimeError: a goal was refused, did not succeed, or did not end.
        """
        self.climb()
        return cast(CoverageResult, self._end(self.bus.send_request(topics.AREA_COVERAGE.endpoint, goal)).result)

    def climb(self) -> None:
        """Get ready and take off.

        Raises:
            RuntimeError: the takeoff did not succeed.
        """
        self.bus.run_for(30.0, lambda: self.status is not None and self.status.ready)
        self._end(self.bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=3.0)))

    def keep(self, folder: Path, goal: AreaCoverageGoal, result: CoverageResult) -> None:
        """Write the dataset, as a client does.

        Raises:
            RuntimeError: a picture is missing.
        """
        with Dataset(folder, "png", goal=goal) as dataset:
            dataset.note(track_ned_m=[o.pos_uav_ned_m for o in self.odometry[::5]])
            for image in result.images:
                pixels = GetImage(goal_id=goal.goal_id, index=image.index)
                request = self.bus.send_request(topics.AREA_COVERAGE.image, pixels)
                self.bus.run_for(1.0, lambda request=request: request.ended)  # type: ignore[misc]
                if not request.replies or request.replies[0].reason:
                    raise RuntimeError(f"no picture {image.index}: {request.replies}")
                dataset.add(Picture(image, request.replies[0].pixels))

    def _end(self, request: SentRequest) -> Result[Any]:
        self.bus.run_for(1800.0, lambda: request.ended)
        last = request.replies[-1] if request.replies else None
        if not isinstance(last, Result) or last.outcome != "succeeded":
            raise RuntimeError(f"the goal did not succeed: {last}")
        return last
