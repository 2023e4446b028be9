"""`python -m jezero.services.rover_driver`: the driver of a real rover."""

import sys
from collections.abc import Mapping

from jezero.base.config import load_config
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink, link_of
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.service import COMMAND_LINK, ODOMETRY_LINK, RealRover, used_links


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The driver, and its lines."""
    config = load_config(RoverDriverConfig, "rover_driver")
    addresses = {
        ODOMETRY_LINK: ("link in rover_driver.toml", config.link),
        COMMAND_LINK: ("command_link in rover_driver.toml", config.command_link),
    }
    return RealRover(config), {each: link_of(*addresses[each]) for each in used_links(config)}


if __name__ == "__main__":
    sys.exit(run_process("rover_driver", build))
