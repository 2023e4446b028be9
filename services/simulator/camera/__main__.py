"""`python -m jezero.services.simulator.camera`: the ventral camera as a process."""

import argparse
import sys
from collections.abc import Mapping

from jezero.base.config import ConfigError, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.making import make_camera
from jezero.services.simulator.camera.service import NoEglError
from jezero.services.simulator.config import SimulatorConfig


def main() -> int:
    parser = argparse.ArgumentParser(prog="jezero.services.simulator.camera", description="The ventral camera.")
    parser.add_argument("--seed", type=int, default=1, help="of the pictures' noise (default 1)")
    seed = parser.parse_args().seed

    def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
        config, simulator = load_config(CameraConfig, "camera"), load_config(SimulatorConfig, "simulator")
        try:
            camera = make_camera(config, simulator, load_config(VehicleConfig, "vehicle"), seed)
        except NoEglError as error:
            raise ConfigError(f'camera.toml says renderer = "egl", but there is {error}') from None
        print(f"camera: {camera.description}")
        return camera, {}

    return run_process("camera", build)


if __name__ == "__main__":
    sys.exit(main())
