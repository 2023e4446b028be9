"""`python -m jezero.services.ground_station`: the pages of the vehicle, in a browser on this machine."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.ground_station.access import listening_of
from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.service import GroundStation


def main() -> int:
    """Serve until SIGTERM."""

    def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
        from jezero.services.ground_station.web.server import PageServer

        config = load_config(GroundStationConfig, "ground_station")
        robot = load_config(VehicleConfig, "vehicle")
        run_folder = Path(os.environ["JEZERO_RUN_DIR"]) if "JEZERO_RUN_DIR" in os.environ else None
        server = PageServer(listening_of(config), robot, instance.vehicle, instance.router, run_folder)
        server.run_in_thread()
        print(f"the pages are on {server.address}")
        return GroundStation(server.health), {}

    return run_process("ground_station", build)


if __name__ == "__main__":
    sys.exit(main())
