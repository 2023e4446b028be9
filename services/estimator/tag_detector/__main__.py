"""`python -m jezero.services.estimator.tag_detector`."""

import sys
from collections.abc import Mapping

from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.service import TagDetector


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The tag detector; it has no link but the bus."""
    return TagDetector(load_config(TagDetectorConfig, "tag_detector"), load_config(VehicleConfig, "vehicle")), {}


if __name__ == "__main__":
    sys.exit(run_process("tag_detector", build))
