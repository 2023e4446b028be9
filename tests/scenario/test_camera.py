"""The camera in flight, in virtual time: errors of the tag detector, and the delay of the pictures."""

from collections.abc import Callable

import msgspec
import pytest

from jezero.base.codec import decode
from jezero.base.config import load_config
from jezero.base.frames import distance, subtract
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.estimate import TagEstimate
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.service import NoEglError
from jezero.services.simulator.config import SimulatorConfig, UavConfig, WindConfig
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight


def over_the_rover(mode: str) -> Callable[[int], MemoryBus]:
    """A stack whose vehicle starts on the rover."""
    simulator = load_config(SimulatorConfig, "simulator")
    simulator = msgspec.structs.replace(simulator, uav=UavConfig(start="platform"), wind=WindConfig(mean_mps=1.0))
    camera = msgspec.structs.replace(load_config(CameraConfig, "camera"), mode=mode, renderer="egl")
    return lambda seed: build_stack(seed, simulator=simulator, camera=camera)


class Comparison:
    """Observes a bus: errors of the tag detector in m, and delays of the pictures in ns."""

    def __init__(self) -> None:
        self.errors_m: list[float] = []
        self.delays_ns: list[int] = []
        self._scenes: dict[int, Scene] = {}

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.SCENE.name:
            scene = msgspec.json.decode(data, type=Scene)
            self._scenes[scene.t_ns] = scene
        elif topic == topics.ESTIMATE_TAG.name:
            estimate = msgspec.json.decode(data, type=TagEstimate)
            scene = self._scenes[estimate.t_ns]
            true_ned_m = subtract(scene.pos_uav_ned_m, scene.pos_rover_ned_m)
            self.errors_m.append(distance(estimate.pos_uav_rel_rover_ned_m, true_ned_m))
        elif topic == topics.CAMERA.name:
            frame = decode(CameraFrame, data)
            assert len(frame.pixels) == 640 * 480 * 3
            self.delays_ns.append(t_ns - frame.t_ns)


@pytest.mark.long
@pytest.mark.parametrize("mode", ["rendered", "projected"])
def test_the_tag_detector_measures_the_position_over_the_rover(mode: str) -> None:
    try:
        flight = Flight(1, over_the_rover(mode))
    except NoEglError as error:
        pytest.skip(str(error))
    comparison = Comparison()
    flight.bus.observe(comparison)
    flight.take_off(1.5)
    flight.bus.run_for(1.0)
    assert len(comparison.errors_m) > 40
    assert max(comparison.errors_m[-15:]) < 0.15
    assert all(100e6 <= delay_ns <= 112e6 for delay_ns in comparison.delays_ns)
    assert bool(comparison.delays_ns) == (mode == "rendered")
