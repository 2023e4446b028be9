"""The whole stack in one process and virtual time: every service of the table that flies, on the memory bus.

Two more services only fly here: a camera whose images cost nothing, and a driver of the rover.
"""

import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import msgspec

from jezero.base.config import load_config
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.mission_files import configured_fence
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus, Observer
from jezero.runtime.service import Inbox, Output, Publish, Service, Spec
from jezero.schemas import topics
from jezero.schemas.commands import RoverCommand
from jezero.schemas.fence import Fence
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.config import load_actions_config
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.mission.config import MissionConfig
from jezero.services.mission.record import MissionRecord
from jezero.services.mission.service import MissionService
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.gimbal import Gimbal
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.table import SERVICES, ServiceRow, make, resolve, services
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge

SYSTEM_ID = 1
BLANK_CAMERA = "blank_camera"
BLANK_CAMERA_HZ = 5.0
BLANK_WIDTH_PX, BLANK_HEIGHT_PX = 16, 12
GREY = bytes([128]) * (3 * BLANK_WIDTH_PX * BLANK_HEIGHT_PX)


def build_stack(
    seed: int,
    *,
    simulator: SimulatorConfig | None = None,
    autopilot: AutopilotConfig | None = None,
    bridge: VehicleBridgeConfig | None = None,
    camera: CameraConfig | None = None,
    estimator: EstimatorConfig | None = None,
    vehicle: VehicleConfig | None = None,
    wrap_simulator: Callable[[Service], Service] = lambda service: service,
    without: Collection[str] = (),
    journal_reader: Observer | None = None,
) -> MemoryBus:
    """Make a bus with all services that fly, at time 0.

    Args:
        seed: seed of the world, the wind, the sensors' errors and the links' delays.
        simulator: settings; like the next five, None loads the configuration file.
        autopilot: settings.
        bridge: settings.
        camera: settings; see `service_makers`.
        estimator: settings.
        vehicle: settings of the vehicle itself.
        wrap_simulator: returns the service that runs in place of the simulator, e.g. one that adds sensor faults.
        without: names of services to leave out.
        journal_reader: gets the services' journals; None keeps none.

    Raises:
        ConfigError: a configuration file is invalid.
    """
    bus = wired_bus(seed)
    if journal_reader is not None:
        bus.read_journals(journal_reader)
    makers = service_makers(
        seed,
        simulator=simulator,
        autopilot=autopilot,
        bridge=bridge,
        camera=camera,
        estimator=estimator,
        vehicle=vehicle,
    )
    for name, maker in makers.items():
        if name in without:
            continue
        service = maker(boot_id(seed, name))
        bus.add(wrap_simulator(service) if name == "simulator" else service)
    return bus


def wired_bus(seed: int) -> MemoryBus:
    """Make a bus without services whose MAVLink links are wired."""
    bus = MemoryBus(seed)
    bus.wire(("simulator", "hil"), ("autopilot", "hil"))
    bus.wire(("autopilot", "offboard"), ("vehicle_bridge", "autopilot"), UDP_DELAY)
    return bus


def boot_id(seed: int, service: str) -> int:
    """Boot id of a service, fixed by the seed."""
    return zlib.crc32(f"{seed}/{service}".encode())


def service_makers(
    seed: int,
    *,
    simulator: SimulatorConfig | None = None,
    autopilot: AutopilotConfig | None = None,
    bridge: VehicleBridgeConfig | None = None,
    camera: CameraConfig | None = None,
    estimator: EstimatorConfig | None = None,
    vehicle: VehicleConfig | None = None,
    system_id: int = SYSTEM_ID,
) -> dict[str, Callable[[int], Service]]:
    """Functions that make each service from its boot id; by service name, in start order.

    Args:
        seed: seed of the world, the wind and the sensors' errors.
        simulator: settings; like the next four, None loads the configuration file.
        autopilot: settings.
        bridge: settings.
        camera: settings; None loads the configuration file and sets the mode "projected", because rendering takes far
            longer than everything else together.
        estimator: settings.
        system_id: MAVLink system id of the autopilot and the bridge.

    Raises:
        ConfigError: a configuration file is invalid.
    """
    robot = vehicle or load_config(VehicleConfig, "vehicle")
    given: dict[str, Any] = {
        "simulator": simulator,
        "autopilot": autopilot,
        "vehicle_bridge": bridge,
        "camera": camera or msgspec.structs.replace(load_config(CameraConfig, "camera"), mode="projected"),
        "estimator": estimator,
        "actions": load_actions_config(robot),
    }
    settings = {
        row.name: given.get(row.name) or load_config(resolve(row.settings), row.name)
        for row in SERVICES
        if row.flies and row.settings
    }
    common = {"vehicle": robot, "seed": seed, "system_id": system_id, "simulator": settings["simulator"]}

    def maker(row: ServiceRow) -> Callable[[int], Service]:
        own = {"config": settings["actions" if row.is_action else row.name]} if row.settings else {}
        return lambda boot: make(row, {**common, **own, "boot_id": boot})

    bridge = settings["vehicle_bridge"]
    return {name: maker(row) for name, row in services().items() if row.flies} | {
        "vehicle_bridge": bridge_maker(bridge, robot, system_id, configured_fence(bridge.fence)),
        "mission": mission_maker(robot),
    }


def bridge_maker(
    config: VehicleBridgeConfig, robot: VehicleConfig, system_id: int, fence: Fence | None = None
) -> Callable[[int], Service]:
    """Function that makes the bridge from its boot id; each run knows the fence of the run before.

    Args:
        fence: the fence of the first run.
    """
    kept = [fence]

    def make(boot: int) -> Service:
        return VehicleBridge(config, robot, system_id, boot, f"{boot:x}", fence=kept[-1], keep_fence=kept.append)

    return make


def mission_maker(robot: VehicleConfig) -> Callable[[int], Service]:
    """Function that makes the mission service from its boot id; each run knows the mission of the run before."""
    config, kept = load_config(MissionConfig, "mission"), list[MissionRecord]()

    def make(boot: int) -> Service:
        saved = kept[-1] if kept else None
        return MissionService(boot, saved=saved, save=kept.append, config=config, vehicle=robot)

    return make


class BlankCamera:
    """Publishes grey images of a few pixels, which cost nothing, with true pointing and times.

    Args:
        config: the camera's settings.
        publishes_info: whether to publish `camera/info` too, where no other camera does.
    """

    def __init__(self, config: CameraConfig, mount: CameraMountConfig, *, publishes_info: bool) -> None:
        self.spec = Spec(
            name=BLANK_CAMERA,
            inputs=(topics.CAMERA_PITCH,),
            outputs=(topics.CAMERA, topics.CAMERA_INFO),
            rate_hz=BLANK_CAMERA_HZ,
        )
        self._config = config
        self._mount = mount
        self._gimbal = Gimbal((mount.pitch_rest_rad, mount.roll_offset_rad), config.axis_rate_max_rps)
        self._publishes_info = publishes_info
        self._sequence = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Publish one image."""
        self._gimbal.update(t_ns, inbox.new(topics.CAMERA_PITCH))
        self._gimbal.move(t_ns)
        self._sequence += 1
        frame = CameraFrame(
            t_ns=t_ns,
            sequence=self._sequence,
            width_px=BLANK_WIDTH_PX,
            height_px=BLANK_HEIGHT_PX,
            pitch_camera_rad=self._gimbal.pitch_rad,
            roll_camera_rad=self._gimbal.roll_rad,
            exposure_s=self._config.exposure_s,
            pixels=GREY,
        )
        yield Publish(topics.CAMERA, frame)
        if self._publishes_info:
            yield Publish(topics.CAMERA_INFO, self._mount.info(t_ns))


class RoverDriver:
    """Publishes the rover's command ten times a second, as `jezero rover drive` does on the Zenoh bus.

    Attributes:
        speed_mps: forward speed of the next commands; None publishes no command.
        yaw_rate_rps: yaw rate of the next commands, clockwise seen from above.
        reverse_s: time after which the yaw rate changes its sign, again and again; None keeps it.
    """

    spec = Spec(name="rover_driver", outputs=(topics.ROVER_COMMAND,), rate_hz=10.0)

    def __init__(self) -> None:
        self.speed_mps: float | None = None
        self.yaw_rate_rps = 0.0
        self.reverse_s: float | None = None

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publish one command."""
        if self.speed_mps is not None:
            reversed_now = self.reverse_s is not None and int(t_ns / (self.reverse_s * NS_PER_S)) % 2 == 1
            yaw_rate_rps = -self.yaw_rate_rps if reversed_now else self.yaw_rate_rps
            command = RoverCommand(t_ns=t_ns, speed_rover_body_mps=self.speed_mps, yaw_rate_rover_rps=yaw_rate_rps)
            yield Publish(topics.ROVER_COMMAND, command)
