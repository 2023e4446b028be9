"""`python -m jezero.services.rover`: the rover's computer, which connects to the simulator over TCP."""

import os
import sys
from collections.abc import Mapping

import msgspec

from jezero.base.config import load_config
from jezero.runtime.instance import Instance, checked_host
from jezero.runtime.links import SILENCE_MAX_S, SocketLink, TcpClient
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.rover.service import SIMULATOR, RoverComputer

VARIABLE = "JEZERO_SIMULATOR"


class _Driver(msgspec.Struct, frozen=True):
    """The fields of `rover_driver.toml` that name a real rover."""

    link: str = ""
    command_link: str = ""


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The rover's computer of an instance, and its link; without one where there is a real rover."""
    driver = load_config(_Driver, "rover_driver")
    if driver.link or driver.command_link:
        return RoverComputer(""), {}
    host, port = checked_host(VARIABLE, os.environ.get(VARIABLE) or "127.0.0.1"), instance.rover_port
    return RoverComputer(f"{host}:{port}"), {SIMULATOR: TcpClient(host, port, silence_max_s=SILENCE_MAX_S)}


if __name__ == "__main__":
    sys.exit(run_process("rover", build))
