"""The table of services: one row a service.

The launcher, the stack in virtual time, replays, the preflight checks and the reference pages read it; tests compare
`deploy/compose.yaml` and `deploy/config/` with it. It imports no service: a row names what makes its service, and
`resolve` imports that on use.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Literal

from jezero.base.plugins import action_names
from jezero.runtime.service import Service

Profile = Literal["sim", "estimation", "control", "ground", "onboard", "rover"]
"""Part of the stack that `jezero up --profile` starts. A stack on one computer has the first four. Of a stack on three
computers, the vehicle's has `onboard`, the rover's `rover`, and the people's `ground`."""


@dataclass(frozen=True, kw_only=True)
class ServiceRow:
    """One service.

    Attributes:
        name: unique within a vehicle, as in `deploy/compose.yaml`; also that of its file in `deploy/config/`.
        about: what it is, for people; the heading of its settings in `docs/reference/settings.md`.
        maker: class or function that makes it, as `module:name`; the module is in the package that its process runs.
            The stack in virtual time gives it those of these arguments that are its parameters: `config`, its settings;
            `vehicle`; `boot_id`; `seed`; `system_id`, that of MAVLink; `simulator`, the simulator's settings.
        profiles: profiles that it belongs to.
        settings: struct of its settings, as `module:name`; "" without any.
        ports: protocol of each port on which it listens, and the property of `Instance` with the port's number.
        flies: whether it also runs in virtual time, where trials and `jezero fly --fast` need it.
        is_action: whether it is a server of an action, which `maker` makes by `name`.
    """

    name: str
    about: str
    maker: str
    profiles: tuple[Profile, ...]
    settings: str = ""
    ports: tuple[tuple[Literal["tcp", "udp"], str], ...] = ()
    flies: bool = False
    is_action: bool = False

    @property
    def module(self) -> str:
        """The package that `python -m` runs; the server of an action gets its name as an argument."""
        return self.maker.partition(":")[0].rpartition(".")[0]


ACTION = ServiceRow(
    name="actions",
    about="All action servers.",
    maker="jezero.services.actions.table:action_server",
    settings="jezero.services.actions.config:ActionsConfig",
    profiles=("control", "onboard"),
    flies=True,
    is_action=True,
)
"""The servers of all actions, of which each is a process; `services` has a row for each."""

SERVICES: tuple[ServiceRow, ...] = (
    ServiceRow(
        name="simulator",
        about="The simulated world, and the errors of its sensors.",
        maker="jezero.services.simulator.service:Simulator",
        settings="jezero.services.simulator.config:SimulatorConfig",
        ports=(("tcp", "hil_port"), ("tcp", "rover_port")),
        profiles=("sim",),
        flies=True,
    ),
    ServiceRow(
        name="camera",
        about="The simulated camera.",
        maker="jezero.services.simulator.camera.making:make_camera",
        settings="jezero.services.simulator.camera.config:CameraConfig",
        profiles=("sim",),
        flies=True,
    ),
    ServiceRow(
        name="camera_driver",
        about="The driver of a real camera, in place of the simulated one.",
        maker="jezero.services.camera.service:CameraDriver",
        settings="jezero.services.camera.config:CameraDriverConfig",
        profiles=("onboard",),
    ),
    ServiceRow(
        name="autopilot",
        about="The embedded autopilot. Settings that PX4 has too keep PX4's names, with the unit appended.",
        maker="jezero.services.autopilot.service:Autopilot",
        settings="jezero.services.autopilot.config:AutopilotConfig",
        ports=(("udp", "autopilot_offboard_port"), ("udp", "autopilot_gcs_port")),
        profiles=("sim",),
        flies=True,
    ),
    ServiceRow(
        name="rover",
        about="The rover's computer.",
        maker="jezero.services.rover.service:RoverComputer",
        profiles=("rover",),
    ),
    ServiceRow(
        name="rover_driver",
        about="The driver of a real rover.",
        maker="jezero.services.rover_driver.service:RealRover",
        settings="jezero.services.rover_driver.config:RoverDriverConfig",
        profiles=("rover",),
    ),
    ServiceRow(
        name="uwb",
        about="The driver of a real UWB module.",
        maker="jezero.services.uwb.service:UwbDriver",
        settings="jezero.services.uwb.config:UwbDriverConfig",
        profiles=("onboard",),
    ),
    ServiceRow(
        name="vehicle_bridge",
        about="The vehicle bridge.",
        maker="jezero.services.vehicle_bridge.service:VehicleBridge",
        settings="jezero.services.vehicle_bridge.config:VehicleBridgeConfig",
        ports=(("udp", "bridge_port"),),
        profiles=("control", "onboard"),
        flies=True,
    ),
    ServiceRow(
        name="tag_detector",
        about="The tag detector.",
        maker="jezero.services.estimator.tag_detector.service:TagDetector",
        settings="jezero.services.estimator.tag_detector.config:TagDetectorConfig",
        profiles=("estimation", "onboard"),
        flies=True,
    ),
    ServiceRow(
        name="estimator",
        about="The estimator.",
        maker="jezero.services.estimator.service:Estimator",
        settings="jezero.services.estimator.config:EstimatorConfig",
        profiles=("estimation", "onboard"),
        flies=True,
    ),
    ACTION,
    ServiceRow(
        name="preflight",
        about="The checks before a takeoff.",
        maker="jezero.services.preflight.service:Preflight",
        profiles=("control", "onboard"),
        flies=True,
    ),
    ServiceRow(
        name="mission",
        about="The mission service: when the vehicle flies home by itself.",
        maker="jezero.services.mission.service:MissionService",
        settings="jezero.services.mission.config:MissionConfig",
        profiles=("control", "onboard"),
        flies=True,
    ),
    ServiceRow(
        name="recorder",
        about="The recorder of flights.",
        maker="jezero.services.recorder.service:Recorder",
        settings="jezero.services.recorder.config:RecorderConfig",
        profiles=("control", "onboard"),
    ),
    ServiceRow(
        name="ground_station",
        about="The ground station.",
        maker="jezero.services.ground_station.service:GroundStation",
        settings="jezero.services.ground_station.config:GroundStationConfig",
        profiles=("ground",),
    ),
)
"""Every service, in the order in which the stack in virtual time starts them."""


def services() -> dict[str, ServiceRow]:
    """Every service by name, in the table's order, with a server for each action of `action_names`."""
    rows: dict[str, ServiceRow] = {}
    for row in SERVICES:
        names = action_names() if row.is_action else (row.name,)
        rows |= {name: replace(row, name=name) for name in names}
    return rows


def resolve(path: str) -> Any:
    """Import what a row names as `module:name`."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


def make(row: ServiceRow, arguments: Mapping[str, Any]) -> Service:
    """Make a service with those of the arguments that its maker has as parameters; a server of an action by its name.

    Raises:
        TypeError: the maker needs other arguments too.
    """
    maker = resolve(row.maker)
    offered = {**arguments, "name": row.name} if row.is_action else arguments
    parameters = inspect.signature(maker).parameters
    service: Service = maker(**{name: value for name, value in offered.items() if name in parameters})
    return service
