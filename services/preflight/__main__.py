"""`python -m jezero.services.preflight`: the preflight checks over Zenoh."""

import sys
from collections.abc import Mapping

from jezero.runtime.config import Instance, load_config
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.preflight.service import Preflight
from jezero.vehicle_config import VehicleConfig


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The preflight service of a vehicle."""
    return Preflight(battery=load_config(VehicleConfig, "vehicle").battery), {}


if __name__ == "__main__":
    sys.exit(run_process("preflight", build))
