"""`python -m jezero.services.estimator.tag_detector`."""

import sys

from jezero.runtime.config import load_config
from jezero.runtime.zenoh_bus import run_process
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.service import TagDetector


def main() -> int:
    """Run until told to stop."""
    config = load_config(TagDetectorConfig, "tag_detector")
    return run_process("tag_detector", lambda _instance, _boot_id: (TagDetector(config), {}))


if __name__ == "__main__":
    sys.exit(main())
