"""One mission flown by the whole stack in virtual time, with its recording and the hash of its messages."""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from jezero.base.codec import decode
from jezero.base.config import load_config
from jezero.base.frames import Vec3, horizontal
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.writer import RecordingWriter
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Feedback
from jezero.schemas.goals import ImagesResult
from jezero.schemas.images import GetImage, Image
from jezero.schemas.rows import Action
from jezero.schemas.state import Status, StatusCode, Truth
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.camera.config import CameraConfig
from jezero.trials.goals import wait_for_result
from jezero.trials.platform import off_platform_reason, offset_m
from jezero.trials.recording import MessageDigest, virtual_recording
from jezero.trials.stack import build_stack

READY_TIMEOUT_S = 60.0
GOAL_TIMEOUT_S = 180.0
IMAGE_TIMEOUT_S = 1.0
Step = tuple[Action[Any], Any, float]


class FlightResult(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a flight in virtual time.

    Attributes:
        result: "succeeded" if every goal succeeded and the vehicle stands disarmed on the rover.
        reason: why the flight failed, or "".
        seed: seed of the world, the wind, the sensors' errors and the links' delays.
        messages_sha256: SHA-256 of all messages; equal for two flights of the same seed.
        sim_time_s: length of the flight in virtual time.
        real_time_factor: virtual seconds per second of this machine, start-up left out.
        touchdown_error_m: horizontal distance between the true position at disarm and the middle of the rover's
            platform; None if the flight failed.
    """

    result: Literal["succeeded", "failed"]
    reason: str = ""
    seed: int
    messages_sha256: str
    sim_time_s: float
    real_time_factor: float
    touchdown_error_m: float | None


class _Recorder:
    """Observer of a bus: hashes all messages, keeps the latest status and truth, and records them if wanted."""

    def __init__(self, writer: RecordingWriter | None) -> None:
        self._digest = MessageDigest()
        self._writer = writer
        self._status: bytes | None = None
        self._truth: bytes | None = None

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        self._digest.update(t_ns, topic, data)
        if self._writer is not None:
            self._writer.write(t_ns, topic, data)
        if topic == topics.STATUS.name:
            self._status = data
        elif topic == topics.TRUTH.name:
            self._truth = data

    def close(self) -> str:
        """Close the recording and return the SHA-256 of all messages."""
        if self._writer is not None:
            self._writer.close()
        return self._digest.hexdigest()

    @property
    def status(self) -> Status | None:
        status: Status | None = None if self._status is None else decode(Status, self._status)
        return status

    @property
    def truth(self) -> Truth | None:
        truth: Truth | None = None if self._truth is None else decode(Truth, self._truth)
        return truth


class CapturedImages(NamedTuple):
    """The images of one goal, and the flight that took them.

    Attributes:
        action: the goal's action.
        goal: the goal as it was sent.
        result: the goal's result.
        track_ned_m: positions of the vehicle in the goal's feedback, in the goal's frame.
        images: (image, its RGB pixels), fetched from the action server one at a time.
    """

    action: Action[Any]
    goal: Any
    result: ImagesResult
    track_ned_m: list[Vec3]
    images: Iterator[tuple[Image, bytes]]


def fly_virtually(
    mission: Sequence[Step],
    seed: int,
    recording: Path | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
    on_images: Callable[[CapturedImages], None] | None = None,
    without: Collection[str] = (),
) -> FlightResult:
    """Fly a mission through all services in one process.

    Args:
        mission: steps of (action, goal, seconds to hover afterwards); the last goal lands on the rover.
        seed: seed of the world, the wind, the sensors' errors and the links' delays.
        recording: file that gets every message.
        on_progress: called with a sentence at the start of each goal.
        on_images: called with the images of each goal that takes any. The camera then renders them; if None, it only
            projects the tags' corners, which is far cheaper.
        without: names of services to leave out.

    Raises:
        ConfigError: a configuration file is invalid.
    """
    camera = (
        None if on_images is None else msgspec.structs.replace(load_config(CameraConfig, "camera"), mode="rendered")
    )
    writer = None if recording is None else virtual_recording(recording, seed)
    bus = build_stack(seed, camera=camera, without=without, journal_reader=None if writer is None else writer.write)
    recorder = _Recorder(writer)
    bus.observe(recorder)
    started_s = time.perf_counter()
    reason = _fly(bus, recorder, mission, on_progress, on_images or (lambda images: None))
    wall_s = time.perf_counter() - started_s
    bus.end_journals()
    return FlightResult(
        result="failed" if reason else "succeeded",
        reason=reason,
        seed=seed,
        messages_sha256=recorder.close(),
        sim_time_s=round(bus.t_ns / NS_PER_S, 3),
        real_time_factor=round(bus.t_ns / NS_PER_S / wall_s, 2),
        touchdown_error_m=None if reason or recorder.truth is None else round(horizontal(offset_m(recorder.truth)), 4),
    )


def _fly(
    bus: MemoryBus,
    recorder: _Recorder,
    mission: Sequence[Step],
    on_progress: Callable[[str], None],
    on_images: Callable[[CapturedImages], None],
) -> str:
    """Fly all goals; returns why the flight failed, or "" if it did not."""

    def is_ready() -> bool:
        status = recorder.status
        return status is not None and status.ready

    if not bus.run_for(READY_TIMEOUT_S, stop=is_ready):
        status = recorder.status
        return f"not ready after {READY_TIMEOUT_S:.0f} s: {status.not_ready_reason if status else 'no status'}"
    for action, goal, hover_s in mission:
        on_progress(f"{action.name} at {bus.t_ns / NS_PER_S:.1f} s")
        query = bus.send_request(action.endpoint, goal)
        reason = wait_for_result(bus, action, query, GOAL_TIMEOUT_S)
        if reason:
            return reason
        if action.takes_pictures:
            on_images(_captured_images(bus, action, goal, query))
        bus.run_for(hover_s)
    status = recorder.status
    if status is None or status.armed or status.code != StatusCode.IDLE:
        return f"not landed and disarmed at the end: status {status.name if status else 'unknown'}"
    if recorder.truth is None:
        return "the simulator published no truth"
    return off_platform_reason(recorder.truth, 0.5 * load_config(VehicleConfig, "vehicle").platform.side_m)


def _captured_images(bus: MemoryBus, action: Action[Any], goal: Any, query: SentRequest) -> CapturedImages:
    result = query.replies[-1].result
    track_ned_m = [reply.feedback.pos_uav_ned_m for reply in query.replies if isinstance(reply, Feedback)]
    return CapturedImages(
        action, goal, result, track_ned_m, _fetch_images(bus, action, query.replies[-1].goal_id, result)
    )


def _fetch_images(
    bus: MemoryBus, action: Action[Any], goal_id: str, result: ImagesResult
) -> Iterator[tuple[Image, bytes]]:
    for image in result.images:
        query = bus.send_request(action.image, GetImage(goal_id=goal_id, index=image.index))
        bus.run_for(IMAGE_TIMEOUT_S, stop=lambda query=query: query.ended)  # type: ignore[misc]
        if not query.replies or query.replies[0].reason:
            raise RuntimeError(f"{action.name} has no image {image.index}: {query.replies}")
        yield image, query.replies[0].pixels
