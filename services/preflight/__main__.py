"""`python -m jezero.services.preflight`: the preflight checks over Zenoh."""

import os
import sys
from collections.abc import Mapping
from datetime import UTC, datetime

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.keys.bundle import VARIABLE
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.preflight.certificate import certificate_problem
from jezero.services.preflight.service import Preflight


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The preflight service of a vehicle."""
    keys = certificate_problem(os.environ.get(VARIABLE), datetime.now(UTC))
    return Preflight(vehicle=load_config(VehicleConfig, "vehicle"), keys=keys), {}


if __name__ == "__main__":
    sys.exit(run_process("preflight", build))
