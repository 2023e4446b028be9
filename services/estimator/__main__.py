"""`python -m jezero.services.estimator`: the estimator over Zenoh."""

import sys
from collections.abc import Mapping

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.service import Estimator


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The estimator; it has no link but the bus."""
    return Estimator(load_config(EstimatorConfig, "estimator"), load_config(VehicleConfig, "vehicle")), {}


if __name__ == "__main__":
    sys.exit(run_process("estimator", build))
