"""`python -m jezero.services.simulator`: the simulator as a process; autopilots connect over TCP to 4560 and up."""

import argparse
import sys

from jezero.runtime.config import ConfigError, instance_from_environment, load_config
from jezero.runtime.links import TcpServer
from jezero.runtime.zenoh_bus import new_boot_id, run_service
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.service import HIL, Simulator


def main() -> int:
    parser = argparse.ArgumentParser(prog="jezero.services.simulator", description="The simulated world.")
    parser.add_argument("--seed", type=int, default=1, help="of wind and sensor errors (default 1)")
    arguments = parser.parse_args()
    try:
        instance = instance_from_environment()
        config = load_config(SimulatorConfig, "simulator")
    except ConfigError as error:
        print(f"simulator: {error}", file=sys.stderr)
        return 2
    boot_id = new_boot_id()
    simulator = Simulator(config, arguments.seed, boot_id)
    try:
        return run_service(simulator, instance, boot_id, {HIL: TcpServer("127.0.0.1", instance.hil_port)})
    finally:
        simulator.close()


if __name__ == "__main__":
    sys.exit(main())
