"""The whole stack in one process and virtual time: every service that `compose.yaml` starts, on the memory bus."""

import zlib
from collections.abc import Callable

from jezero.runtime.config import load_config
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus
from jezero.runtime.service import Service
from jezero.services.actions.table import BEHAVIOURS, action_server
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.service import Autopilot
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.service import Simulator
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge

SYSTEM_ID = 1


def boot_id(seed: int, service: str) -> int:
    """The id of a service's run, fixed by the seed."""
    return zlib.crc32(f"{seed}/{service}".encode())


def build_stack(
    seed: int,
    *,
    simulator: SimulatorConfig | None = None,
    autopilot: AutopilotConfig | None = None,
    bridge: VehicleBridgeConfig | None = None,
    wrap_simulator: Callable[[Service], Service] = lambda service: service,
) -> MemoryBus:
    """A bus with the simulator, the embedded autopilot, the bridge and the action servers, at time 0.

    Args:
        seed: of the world, the noise, the wind and the links' delays.
        simulator, autopilot, bridge: settings other than those of the configuration files.
        wrap_simulator: puts something in front of the simulator, such as a fault of a sensor.

    Raises:
        ConfigError: a configuration file is wrong.
    """
    bus = MemoryBus(seed)
    bus.wire(("simulator", "hil"), ("autopilot", "hil"))
    bus.wire(("autopilot", "offboard"), ("vehicle_bridge", "autopilot"), UDP_DELAY)
    config = simulator or load_config(SimulatorConfig, "simulator")
    bus.add(wrap_simulator(Simulator(config, seed=seed, boot_id=boot_id(seed, "simulator"))))
    bus.add(
        Autopilot(
            autopilot or load_config(AutopilotConfig, "autopilot"),
            system_id=SYSTEM_ID,
            boot_id=boot_id(seed, "autopilot"),
        )
    )
    bus.add(
        VehicleBridge(
            bridge or load_config(VehicleBridgeConfig, "vehicle_bridge"),
            system_id=SYSTEM_ID,
            boot_id=boot_id(seed, "vehicle_bridge"),
        )
    )
    for name in BEHAVIOURS:
        bus.add(action_server(name, boot_id(seed, name)))
    return bus
