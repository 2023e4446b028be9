"""Recordings of flights in virtual time, with the recorder's settings."""

from pathlib import Path

from jezero.recording.about import about
from jezero.recording.viewer_scene import ViewerScene
from jezero.recording.writer import RecordingWriter
from jezero.runtime.config import load_config
from jezero.services.recorder.config import RecorderConfig
from jezero.vehicle_config import VehicleConfig


def virtual_recording(path: Path, seed: int, **origin: str) -> RecordingWriter:
    """Begin the recording of a flight in virtual time.

    Args:
        path: the file.
        seed: seed of the flight.
        origin: more fields that say what is recorded.

    Raises:
        ConfigError: a settings file is invalid.
        OSError: the file can't be written.
    """
    return RecordingWriter(
        path,
        about(bus="virtual", seed=str(seed), **origin),
        image_format=load_config(RecorderConfig, "recorder").image_format,
        scene=ViewerScene(load_config(VehicleConfig, "vehicle")),
    )
