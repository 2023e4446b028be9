"""What a mission flies in: the real simulator and autopilot, or the point mass in the place of both."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from random import Random
from typing import Any, Protocol

import msgspec

from jezero.runtime.config import load_config
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus
from jezero.runtime.service import Service
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.table import DECLARATIONS, action_server
from jezero.services.autopilot.config import AutopilotConfig, TelemetryConfig
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge
from jezero.trials.campaign.blank_camera import NAME as BLANK_CAMERA
from jezero.trials.campaign.blank_camera import BlankCamera
from jezero.trials.campaign.faults import AUTOPILOT, BRIDGE, SIMULATOR, Fault
from jezero.trials.campaign.point_mass_faults import FaultyPointMass, as_in_point_mass
from jezero.trials.campaign.point_mass_world import NAME, PointMass
from jezero.trials.campaign.sensor_faults import FaultySimulator, SensorFault
from jezero.trials.stack import SYSTEM_ID, service_makers, wired_bus
from jezero.vehicle_config import VehicleConfig

TELEMETRY_INTERVAL_S = 0.1
BRIDGE_HZ, SERVERS_HZ = 20.0, 5.0
"""At the point mass nothing is told more often, and nobody steps more often by himself: a second costs less."""
Makers = dict[str, Callable[[int], Service]]


class Sensing(Service, Protocol):
    """A service whose sensors can fail."""

    active: list[SensorFault]

    def begin(self, fault: Fault) -> SensorFault: ...


@dataclass(frozen=True)
class World:
    """One kind of world.

    Attributes:
        sensing, autopilot: names of the service with the sensors, and of the one that the bridge speaks MAVLink with.
        make_bus: a bus without services, from the seed.
        make_makers: by name and in the order of their start, what makes a service from the id of its run.
        with_faults: puts faults of sensors in front of the service that has them.
        translate: a fault of the physical world, as it is here.
    """

    sensing: str
    autopilot: str
    make_bus: Callable[[int], MemoryBus]
    make_makers: Callable[[int], Makers]
    with_faults: Callable[[Any, Random], Sensing]
    translate: Callable[[Fault], Fault]


def _point_mass_bus(seed: int) -> MemoryBus:
    bus = MemoryBus(seed)
    bus.wire((NAME, "offboard"), (BRIDGE, "autopilot"), UDP_DELAY)
    return bus


def _blank_camera(vehicle: VehicleConfig, *, describes_itself: bool) -> BlankCamera:
    return BlankCamera(load_config(CameraConfig, "camera"), vehicle.camera, describes_itself=describes_itself)


def _point_mass_makers(seed: int) -> Makers:
    """Only what commands the vehicle: filters, cameras and detectors would cost many times as much."""
    config = msgspec.structs.replace(
        load_config(AutopilotConfig, "autopilot"), telemetry=TelemetryConfig(interval_min_s=TELEMETRY_INTERVAL_S)
    )
    place = load_config(SimulatorConfig, "simulator")
    bridge = msgspec.structs.replace(load_config(VehicleBridgeConfig, "vehicle_bridge"), rate_hz=BRIDGE_HZ)
    actions, vehicle = load_config(ActionsConfig, "actions"), load_config(VehicleConfig, "vehicle")
    lifecycle = msgspec.structs.replace(actions.lifecycle, step_rate_hz=SERVERS_HZ)
    actions = msgspec.structs.replace(actions, lifecycle=lifecycle)
    return {
        NAME: partial(PointMass, config, place, vehicle, SYSTEM_ID, seed),
        BRIDGE: lambda boot: VehicleBridge(bridge, system_id=SYSTEM_ID, boot_id=boot),
        BLANK_CAMERA: lambda boot: _blank_camera(vehicle, describes_itself=True),
        **{name: partial(action_server, name, config=actions) for name in DECLARATIONS},
    }


def _physics_makers(seed: int) -> Makers:
    """All services, with a camera that projects tags, and small grey pictures for those who want some."""
    vehicle = load_config(VehicleConfig, "vehicle")
    blank = {BLANK_CAMERA: lambda boot: _blank_camera(vehicle, describes_itself=False)}
    return service_makers(seed) | blank


PHYSICS = World(
    sensing=SIMULATOR,
    autopilot=AUTOPILOT,
    make_bus=wired_bus,
    make_makers=_physics_makers,
    with_faults=FaultySimulator,
    translate=lambda fault: fault,
)
POINT_MASS = World(
    sensing=NAME,
    autopilot=NAME,
    make_bus=_point_mass_bus,
    make_makers=_point_mass_makers,
    with_faults=FaultyPointMass,
    translate=as_in_point_mass,
)
WORLDS = {"physics": PHYSICS, "point-mass": POINT_MASS}
