"""`python -m jezero.services.uwb`: the driver of the vehicle's UWB module."""

import sys
from collections.abc import Mapping

from jezero.base.config import ConfigError, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink, link_of
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.uwb.config import UwbDriverConfig
from jezero.services.uwb.service import LINK, UwbDriver


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The driver, and the line to its module."""
    config = load_config(UwbDriverConfig, "uwb")
    vehicle = load_config(VehicleConfig, "vehicle")
    if not config.link:
        return UwbDriver(config, vehicle), {}
    if not vehicle.uwb.id_anchors:
        raise ConfigError(
            "uwb.toml names a UWB module, but vehicle.toml no anchor's module: write the id of each anchor's module "
            'into id_anchors in [uwb], in the order of the places, such as ["022E", "1A2B", "0C31"]'
        )
    return UwbDriver(config, vehicle), {LINK: link_of("link in uwb.toml", config.link)}


if __name__ == "__main__":
    sys.exit(run_process("uwb", build))
