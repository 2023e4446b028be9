"""`python -m jezero.services.estimator.tag_detector`."""

import sys

from jezero.runtime.config import load_config
from jezero.runtime.zenoh_bus import run_process
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.service import TagDetector
from jezero.vehicle_config import VehicleConfig


def main() -> int:
    """Run until stopped."""
    config, vehicle = load_config(TagDetectorConfig, "tag_detector"), load_config(VehicleConfig, "vehicle")
    return run_process("tag_detector", lambda _instance, _boot_id: (TagDetector(config, vehicle), {}))


if __name__ == "__main__":
    sys.exit(main())
