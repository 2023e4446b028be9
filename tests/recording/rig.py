"""A short recording, made by hand."""

from pathlib import Path

from jezero.base.codec import encode
from jezero.recording.writer import RecordingWriter
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Clock
from tests.client.rig import ODOMETRY, a_status

ABOUT = {"version": "0.1.0", "vehicle": "uav1"}
SECOND_NS = 1_000_000_000


def record(path: Path, seconds: int = 3) -> Path:
    """Write a recording: each second 10 altimeter messages, 1 clock, 1 odometry and 1 status."""
    with RecordingWriter(path, ABOUT) as writer:
        for tenth in range(10 * seconds):
            t_ns = tenth * SECOND_NS // 10
            range_m = None if tenth == 0 else 0.1 * tenth
            writer.write(t_ns, topics.ALTIMETER.name, encode(Altimeter(t_ns=t_ns, range_m=range_m)))
            if tenth % 10 == 5:
                writer.write(t_ns, topics.CLOCK.name, encode(Clock(t_ns=t_ns, epoch_id=1, wall_ns=t_ns)))
                writer.write(t_ns, topics.ODOMETRY.name, encode(ODOMETRY))
                writer.write(t_ns, topics.STATUS.name, encode(a_status(t_ns=t_ns)))
    return path
