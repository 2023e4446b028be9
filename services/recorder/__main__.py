"""`python -m jezero.services.recorder`: records the vehicle's messages below `JEZERO_RUN_DIR`."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from jezero.base.config import chosen_autopilot, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.about import about
from jezero.recording.folder import RECORDINGS, RecordingFolder
from jezero.recording.viewer_scene import ViewerScene
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import Worker, run_process
from jezero.runtime.service import Service
from jezero.services.recorder.config import RecorderConfig
from jezero.services.recorder.service import Recorder


def main() -> int:
    """Record until SIGTERM, then finish the file."""
    opened: list[tuple[Recorder, RecordingFolder]] = []
    worker = Worker()

    def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
        config = load_config(RecorderConfig, "recorder")
        folder = Path(os.environ.get("JEZERO_RUN_DIR") or ".").absolute() / RECORDINGS
        origin = about(bus="zenoh", vehicle=instance.vehicle, autopilot=chosen_autopilot())
        size_max_bytes = int(1e6 * config.file_size_max_mb)
        scene = ViewerScene(load_config(VehicleConfig, "vehicle"))
        recordings = RecordingFolder(folder, origin, size_max_bytes, config.image_format, scene)
        recorder = Recorder(recordings.write, images=config.images != "none", execute=worker.add)
        opened.append((recorder, recordings))
        return recorder, {}

    code = run_process("recorder", build)
    for recorder, recordings in opened:
        recorder.finish()
        worker.wait()
        recordings.close()
    return code


if __name__ == "__main__":
    sys.exit(main())
