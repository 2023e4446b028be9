"""Models of the vehicle in a mission: the simulator and the embedded autopilot, or the point mass in place of both."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from random import Random
from typing import Any, Protocol

import msgspec

from jezero.base.config import load_config
from jezero.base.plugins import action_names
from jezero.base.vehicle_config import AirframeConfig, VehicleConfig
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus
from jezero.runtime.service import Service
from jezero.services.actions.config import load_actions_config
from jezero.services.actions.table import action_server
from jezero.services.autopilot.config import AutopilotConfig, TelemetryConfig
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.trials.campaign.faults import AUTOPILOT, BRIDGE, SIMULATOR, Fault, FaultySimulator, SensorFault
from jezero.trials.campaign.point_mass import NAME, FaultyPointMass, PointMass, point_mass_fault
from jezero.trials.stack import BLANK_CAMERA, SYSTEM_ID, BlankCamera, bridge_maker, service_makers, wired_bus

TELEMETRY_INTERVAL_S = 0.1
BRIDGE_HZ, SERVERS_HZ = 20.0, 5.0
"""Rates with the point mass, lower than in real flights, so that a mission takes less time."""
Makers = dict[str, Callable[[int], Service]]


class FaultySensors(Service, Protocol):
    """A service whose sensors can fail."""

    active: list[SensorFault]

    def start(self, fault: Fault) -> SensorFault: ...


@dataclass(frozen=True)
class CampaignModel:
    """One model of the vehicle.

    Attributes:
        sensors: name of the service that has the sensors.
        autopilot: name of the service with which the bridge exchanges MAVLink.
        make_bus: returns a bus without services from the seed.
        make_service_makers: returns, from the seed, functions that make each service from its boot id; by service name,
            in start order.
        add_sensor_faults: wraps the service that has the sensors.
        translate_fault: returns the fault of this model that corresponds to one of the physics.
    """

    sensors: str
    autopilot: str
    make_bus: Callable[[int], MemoryBus]
    make_service_makers: Callable[[int], Makers]
    add_sensor_faults: Callable[[Any, Random], FaultySensors]
    translate_fault: Callable[[Fault], Fault]


def _point_mass_bus(seed: int) -> MemoryBus:
    bus = MemoryBus(seed)
    bus.wire((NAME, "offboard"), (BRIDGE, "autopilot"), UDP_DELAY)
    return bus


def _blank_camera(vehicle: VehicleConfig, *, publishes_info: bool) -> BlankCamera:
    return BlankCamera(load_config(CameraConfig, "camera"), vehicle.camera, publishes_info=publishes_info)


def _without_drag(airframe: AirframeConfig) -> AirframeConfig:
    """The point mass has no drag: with that of the vehicle, its speed would be taken for wind."""
    return msgspec.structs.replace(airframe, drag_rotors_nspm=0.0, drag_area_side_m2=0.0, drag_area_top_m2=0.0)


def _point_mass_makers(seed: int) -> Makers:
    """Only services that command the vehicle: filters, cameras and detectors would take many times as long."""
    config = msgspec.structs.replace(
        load_config(AutopilotConfig, "autopilot"), telemetry=TelemetryConfig(interval_min_s=TELEMETRY_INTERVAL_S)
    )
    place = load_config(SimulatorConfig, "simulator")
    bridge = msgspec.structs.replace(load_config(VehicleBridgeConfig, "vehicle_bridge"), rate_hz=BRIDGE_HZ)
    vehicle = load_config(VehicleConfig, "vehicle")
    vehicle = msgspec.structs.replace(vehicle, airframe=_without_drag(vehicle.airframe))
    actions = load_actions_config(vehicle)
    lifecycle = msgspec.structs.replace(actions.lifecycle, step_rate_hz=SERVERS_HZ)
    actions = msgspec.structs.replace(actions, lifecycle=lifecycle)
    return {
        NAME: partial(PointMass, config, place, vehicle, SYSTEM_ID, seed),
        BRIDGE: bridge_maker(bridge, vehicle, SYSTEM_ID),
        BLANK_CAMERA: lambda boot: _blank_camera(vehicle, publishes_info=True),
        **{name: partial(action_server, name, config=actions) for name in action_names()},
    }


def _physics_makers(seed: int) -> Makers:
    """All services, with a camera that projects tags and a second one with small grey images for other goals."""
    vehicle = load_config(VehicleConfig, "vehicle")
    blank = {BLANK_CAMERA: lambda boot: _blank_camera(vehicle, publishes_info=False)}
    return service_makers(seed) | blank


PHYSICS = CampaignModel(
    sensors=SIMULATOR,
    autopilot=AUTOPILOT,
    make_bus=wired_bus,
    make_service_makers=_physics_makers,
    add_sensor_faults=FaultySimulator,
    translate_fault=lambda fault: fault,
)
POINT_MASS = CampaignModel(
    sensors=NAME,
    autopilot=NAME,
    make_bus=_point_mass_bus,
    make_service_makers=_point_mass_makers,
    add_sensor_faults=FaultyPointMass,
    translate_fault=point_mass_fault,
)
MODELS = {"physics": PHYSICS, "point-mass": POINT_MASS}
