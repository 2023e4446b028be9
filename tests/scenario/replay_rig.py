"""Recordings of a stack in virtual time that stands for a while, takes off and hovers."""

from pathlib import Path
from typing import Literal

import msgspec

from jezero.base.config import load_config
from jezero.recording.images import ImageFormat
from jezero.recording.writer import RecordingWriter
from jezero.runtime.memory_bus import SentRequest
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.services.simulator.camera.config import CameraConfig
from jezero.trials.stack import build_stack

SEED = 3
STANDING_S = 8.0


def record_takeoff(path: Path) -> list[SentRequest]:
    """Record a refused and an accepted takeoff; returns both requests."""
    with RecordingWriter(path, {}) as writer:
        bus = build_stack(SEED, journal_reader=writer.write)
        bus.observe(writer.write)
        bus.run_for(STANDING_S)
        requests = []
        for altitude_m in (-5.0, 2.0):
            requests.append(bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=altitude_m)))
            bus.run_for(4.0)
        bus.end_journals()
    return requests


def record_standing(path: Path, image_format: ImageFormat | None, mode: Literal["projected", "rendered"]) -> None:
    """Record a stack that stands on the rover for two seconds, and its camera."""
    camera = msgspec.structs.replace(load_config(CameraConfig, "camera"), mode=mode)
    with RecordingWriter(path, {}, image_format=image_format) as writer:
        bus = build_stack(SEED, camera=camera, journal_reader=writer.write)
        bus.observe(writer.write)
        bus.run_for(2.0)
        bus.end_journals()
