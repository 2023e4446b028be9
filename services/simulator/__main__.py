"""`python -m jezero.services.simulator`: the simulator as a process.

Autopilots connect over TCP to 4560 and up, the rover's computer to 4810 and up.
"""

import argparse
import sys
from collections.abc import Mapping

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance, checked_host
from jezero.runtime.links import SILENCE_MAX_S, SocketLink, TcpServer
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.rover_port import ROVER
from jezero.services.simulator.service import HIL, Simulator

HOST = "127.0.0.1"


def main() -> int:
    parser = argparse.ArgumentParser(prog="jezero.services.simulator", description="The simulated world.")
    parser.add_argument("--seed", type=int, default=1, help="of wind and sensor errors (default 1)")
    seed = parser.parse_args().seed

    def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
        config, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
        rover_host = checked_host("rover_host in simulator.toml", config.rover_host)
        return Simulator(config, vehicle, seed, boot_id), {
            HIL: TcpServer(HOST, instance.hil_port),
            ROVER: TcpServer(rover_host, instance.rover_port, silence_max_s=SILENCE_MAX_S),
        }

    return run_process("simulator", build)


if __name__ == "__main__":
    sys.exit(main())
