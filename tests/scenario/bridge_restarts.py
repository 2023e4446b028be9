"""Flights whose vehicle bridge is killed in some phase and started again, for either autopilot."""

from collections.abc import Callable
from math import degrees
from typing import Any

from benchmarks.quality.orbit import Black
from jezero.base.config import load_config
from jezero.base.frames import altitude_m, tilt_from_quat
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted
from jezero.schemas.commands import Hover
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, TakeoffGoal
from jezero.schemas.rows import Action
from jezero.schemas.state import StatusCode
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.service import CameraSimulator
from jezero.trials.stack import SYSTEM_ID, boot_id, service_makers, wired_bus
from tests.scenario.rig import Flight, go_to, land_at

BRIDGE = "vehicle_bridge"
ROVER_SENSING = ("estimator", "tag_detector")
RESTART_S = 0.7
"""Time in which the launcher restarts a killed bridge."""
LANDED_TIMEOUT_S, READY_TIMEOUT_S = 60.0, 15.0
SQUARE_M = ((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0))


class BridgeFlight(Flight):
    """A stack whose bridge can be killed and started again.

    Args:
        autopilot: a service in place of the embedded autopilot, and its MAVLink system id.
    """

    def __init__(self, autopilot: tuple[Service, int] | None = None, seed: int = 1) -> None:
        self._makers = service_makers(seed, system_id=SYSTEM_ID if autopilot is None else autopilot[1])
        if autopilot is not None:
            self._makers["autopilot"] = lambda _: autopilot[0]
        camera, vehicle = load_config(CameraConfig, "camera"), load_config(VehicleConfig, "vehicle")
        self._makers["camera"] = lambda _: CameraSimulator(camera, vehicle, Black(vehicle.camera), seed)
        self._boots = 0
        super().__init__(seed, self._make_bus)

    def _make_bus(self, seed: int) -> MemoryBus:
        bus = wired_bus(seed)
        for name, make in self._makers.items():
            if name not in ROVER_SENSING:
                bus.add(make(boot_id(seed, name)))
        return bus

    def kill_bridge(self) -> None:
        """End the bridge in the middle of whatever it does."""
        self.bus.remove(BRIDGE)
        self.statuses.clear()
        self.codes.clear()

    def start_bridge(self) -> None:
        """Start another bridge, which knows nothing of the one before."""
        self._boots += 1
        self.bus.add(self._makers[BRIDGE](self._boots))

    def restart_bridge(self) -> None:
        """End the bridge and start another one as soon as the launcher does."""
        self.kill_bridge()
        self.bus.run_for(RESTART_S)
        self.start_bridge()

    def begin(self, action: Action[Any], goal: Any, code: StatusCode, seconds: float) -> None:
        """Fly a goal for some time after it has the given status."""
        self.take_off(3.0)
        reply = self.send(action, goal).replies[0]
        assert isinstance(reply, Accepted), reply
        self.wait_code(code, 20.0)
        self.bus.run_for(seconds)
        assert self.status.code == code


def _takeoff(flight: BridgeFlight) -> None:
    flight.wait_ready()
    flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=3.0))
    flight.wait(lambda: altitude_m(flight.truth.pos_uav_ned_m[2]) > 1.5, 15.0, "climbing")
    assert flight.status.code == StatusCode.TAKEOFF


def _landing(flight: BridgeFlight) -> None:
    flight.begin(topics.LAND_ON_SPOT, land_at(0.0, 2.0), StatusCode.LANDING, 0.1)
    flight.wait(lambda: altitude_m(flight.truth.pos_uav_ned_m[2]) < 1.5, 30.0, "descending")
    assert flight.status.armed


ORBIT = GetImagesGoal(center_ned_m=(0.0, 0.0, -3.0), radius_m=3.0, num_images=4)
COVERAGE = AreaCoverageGoal(polygon_ned_m=SQUARE_M, z_ned_m=-4.0, resolution_m=1.0)

GROUND: dict[str, Callable[[BridgeFlight], object]] = {
    "before the estimate has converged": lambda f: f.bus.run_for(1.0),
    "ready on the ground": BridgeFlight.wait_ready,
}
AIR: dict[str, Callable[[BridgeFlight], object]] = {
    "takeoff": _takeoff,
    "hover": lambda f: f.take_off(3.0),
    "go_to": lambda f: f.begin(topics.GO_TO, go_to(8.0, 0.0, -3.0), StatusCode.GO_TO, 2.0),
    "orbit": lambda f: f.begin(topics.GET_IMAGES, ORBIT, StatusCode.GET_IMAGES, 4.0),
    "coverage": lambda f: f.begin(topics.AREA_COVERAGE, COVERAGE, StatusCode.COVERAGE, 4.0),
    "landing": _landing,
}
"""What brings a stack that has just started into each phase, on the ground and in the air."""


def restart_on_the_ground(flight: BridgeFlight, phase: str) -> None:
    """Restart the bridge before the takeoff."""
    GROUND[phase](flight)
    flight.restart_bridge()
    _assert_flies(flight)
    assert StatusCode.EXTERNAL not in flight.codes


def restart_at_once(flight: BridgeFlight, phase: str) -> None:
    """Restart the bridge in flight as the launcher does; the autopilot's failsafe lands."""
    AIR[phase](flight)
    flight.restart_bridge()
    flight.wait_code(StatusCode.EXTERNAL, 5.0)
    flight.wait_code(StatusCode.IDLE, LANDED_TIMEOUT_S)
    assert flight.codes == [StatusCode.EXTERNAL, StatusCode.IDLE]
    _assert_flies(flight)


def restart_after_the_failsafe_has_landed(flight: BridgeFlight, phase: str) -> None:
    """Start the bridge again when the vehicle stands with its motors off."""
    AIR[phase](flight)
    flight.kill_bridge()
    assert flight.bus.run_for(LANDED_TIMEOUT_S, lambda: not flight.truth.armed_motors), "the failsafe has not landed"
    flight.start_bridge()
    _assert_flies(flight)


def take_back_with_a_hover(flight: BridgeFlight, phase: str) -> None:
    """Request a hover of the bridge that was restarted in flight, and go on flying."""
    AIR[phase](flight)
    flight.restart_bridge()
    flight.wait_code(StatusCode.EXTERNAL, 5.0)
    assert flight.request(topics.HOVER, Hover()).hover_mode
    flight.wait_code(StatusCode.HOVER, 5.0)
    flight.do(topics.GO_TO, go_to(0.0, 0.0, -3.0))
    assert _has_origin(flight)


RESTARTS = [
    *((restart_on_the_ground, phase) for phase in GROUND),
    *((restart_at_once, phase) for phase in AIR),
    *((restart_after_the_failsafe_has_landed, phase) for phase in AIR),
    *((take_back_with_a_hover, phase) for phase in AIR),
]
"""Each kind of restart with each phase in which it happens."""


def _has_origin(flight: BridgeFlight) -> bool:
    odometry = flight.status.odometry
    return odometry is not None and odometry.origin_deg is not None


def _assert_flies(flight: BridgeFlight) -> None:
    """Assert that the vehicle gets ready upright, and that the next takeoff ends in a hover."""
    flight.wait(lambda: bool(flight.statuses) and flight.status.ready, READY_TIMEOUT_S, "ready")
    assert degrees(tilt_from_quat(flight.truth.q_ned_from_frd)) < 10.0
    assert _has_origin(flight)
    flight.do(topics.TAKEOFF, TakeoffGoal(altitude_m=2.0))
    flight.wait_code(StatusCode.HOVER, 5.0)
