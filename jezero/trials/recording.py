"""What is kept of a flight in virtual time: its recording, by the recorder's settings, and the hash of its messages."""

import hashlib
from pathlib import Path

from jezero.base.codec import split_attachment
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.about import about
from jezero.recording.viewer_scene import ViewerScene
from jezero.recording.writer import RecordingWriter
from jezero.services.recorder.config import RecorderConfig


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


class MessageDigest:
    """SHA-256 of the messages of a bus, of images the header only."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def update(self, t_ns: int, topic: str, data: bytes) -> None:
        """Add one message."""
        self._digest.update(b"%d %s %b\n" % (t_ns, topic.encode(), split_attachment(data)[0]))

    def hexdigest(self) -> str:
        """The hash of the messages so far."""
        return self._digest.hexdigest()
