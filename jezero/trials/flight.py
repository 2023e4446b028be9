"""A mission flown in virtual time, with its log, its hash and its figures."""

import hashlib
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from jezero.frames import Vec3, horizontal
from jezero.report.flight_log import line
from jezero.runtime.codec import decode
from jezero.runtime.config import load_config
from jezero.runtime.memory_bus import Answers, MemoryBus
from jezero.schemas import topics
from jezero.schemas.actions import Feedback, ImagesResult
from jezero.schemas.images import GetImage, Image
from jezero.schemas.state import Status, StatusCode, Truth
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SimulatorConfig
from jezero.trials.goals import wait_for_result
from jezero.trials.platform import off_platform_reason, offset_m
from jezero.trials.stack import build_stack

READY_WITHIN_S = 60.0
GOAL_WITHIN_S = 180.0
PICTURE_WITHIN_S = 1.0
Step = tuple[topics.Action[Any], Any, float]


class FlightResult(msgspec.Struct, frozen=True, kw_only=True):
    """How a flight in virtual time went.

    Attributes:
        result: succeeded when every goal did, and the vehicle stands disarmed on the rover.
        reason: why it did not.
        log_sha256: of the log, as `sha256sum` prints it for the file.
        real_time_factor: virtual seconds per second of this machine, start-up left out.
        touchdown_error_m: horizontal distance of the true position at disarm from the middle of the rover's platform;
            None when the vehicle did not land on it.
    """

    result: Literal["succeeded", "failed"]
    reason: str = ""
    seed: int
    log_sha256: str
    sim_time_s: float
    real_time_factor: float
    touchdown_error_m: float | None


class _Recorder:
    """Keeps the hash, the newest status and the newest truth of a bus, and writes the log where one is wanted."""

    def __init__(self, path: Path | None) -> None:
        self._digest = hashlib.sha256()
        self._file = None if path is None else path.open("wb")
        self._status: bytes | None = None
        self._truth: bytes | None = None

    def __call__(self, t_ns: int, topic: str, data: bytes) -> None:
        text = line(t_ns, topic, data)
        self._digest.update(text)
        if self._file is not None:
            self._file.write(text)
        if topic == topics.STATUS.name:
            self._status = data
        elif topic == topics.TRUTH.name:
            self._truth = data

    def close(self) -> str:
        if self._file is not None:
            self._file.close()
        return self._digest.hexdigest()

    @property
    def status(self) -> Status | None:
        status: Status | None = None if self._status is None else decode(Status, self._status)
        return status

    @property
    def truth(self) -> Truth | None:
        truth: Truth | None = None if self._truth is None else decode(Truth, self._truth)
        return truth


class Photographed(NamedTuple):
    """What a goal that takes pictures has left.

    Attributes:
        track_ned_m: the way flown, in the goal's frame.
        pictures: with their pixels, one at a time.
    """

    action: topics.Action[Any]
    goal: Any
    result: ImagesResult
    track_ned_m: list[Vec3]
    pictures: Iterator[tuple[Image, bytes]]


def fly_virtually(
    mission: Sequence[Step],
    seed: int,
    log: Path | None = None,
    tell: Callable[[str], None] = lambda text: None,
    keep: Callable[[Photographed], None] | None = None,
    without: Collection[str] = (),
) -> FlightResult:
    """Fly a mission through all services in one process.

    Args:
        mission: (action, goal, seconds to hover afterwards) in turn; the last one lands on the rover.
        log: file to write every message to.
        tell: called with a sentence on each step.
        keep: called after each goal that takes pictures, which the camera then renders; None: it only projects tags.
        without: names of services that don't fly along.
    """
    camera = None if keep is None else msgspec.structs.replace(load_config(CameraConfig, "camera"), mode="rendered")
    bus = build_stack(seed, camera=camera, without=without)
    recorder = _Recorder(log)
    bus.observe(recorder)
    started = time.perf_counter()
    reason = _fly(bus, recorder, mission, tell, keep or (lambda photographed: None))
    wall_s = time.perf_counter() - started
    return FlightResult(
        result="failed" if reason else "succeeded",
        reason=reason,
        seed=seed,
        log_sha256=recorder.close(),
        sim_time_s=round(bus.t_ns / NS_PER_S, 3),
        real_time_factor=round(bus.t_ns / NS_PER_S / wall_s, 2),
        touchdown_error_m=None if reason or recorder.truth is None else round(horizontal(offset_m(recorder.truth)), 4),
    )


def _fly(
    bus: MemoryBus,
    recorder: _Recorder,
    mission: Sequence[Step],
    tell: Callable[[str], None],
    keep: Callable[[Photographed], None],
) -> str:
    """Fly all goals; returns why it failed, or "" when it did not."""

    def is_ready() -> bool:
        status = recorder.status
        return status is not None and status.ready

    if not bus.run_for(READY_WITHIN_S, stop=is_ready):
        status = recorder.status
        return f"not ready after {READY_WITHIN_S:.0f} s: {status.not_ready_reason if status else 'no status'}"
    for action, goal, hover_s in mission:
        tell(f"{action.name} at {bus.t_ns / NS_PER_S:.1f} s")
        answers = bus.ask(action.endpoint, goal)
        reason = wait_for_result(bus, action, answers, GOAL_WITHIN_S)
        if reason:
            return reason
        if action.takes_pictures:
            keep(_photographed(bus, action, goal, answers))
        bus.run_for(hover_s)
    status = recorder.status
    if status is None or status.armed or status.code != StatusCode.IDLE:
        return f"not landed and disarmed at the end: status {status.name if status else 'unknown'}"
    if recorder.truth is None:
        return "the simulator told no truth"
    return off_platform_reason(recorder.truth, 0.5 * load_config(SimulatorConfig, "simulator").rover.platform_side_m)


def _photographed(bus: MemoryBus, action: topics.Action[Any], goal: Any, answers: Answers) -> Photographed:
    result = answers.replies[-1].result
    track_ned_m = [reply.feedback.pos_uav_ned_m for reply in answers.replies if isinstance(reply, Feedback)]
    return Photographed(action, goal, result, track_ned_m, _pictures(bus, action, answers.replies[-1].goal_id, result))


def _pictures(
    bus: MemoryBus, action: topics.Action[Any], goal_id: str, result: ImagesResult
) -> Iterator[tuple[Image, bytes]]:
    for image in result.images:
        answers = bus.ask(action.image, GetImage(goal_id=goal_id, index=image.index))
        bus.run_for(PICTURE_WITHIN_S, stop=lambda answers=answers: answers.ended)  # type: ignore[misc]
        if not answers.replies or answers.replies[0].reason:
            raise RuntimeError(f"{action.name} has no picture {image.index}: {answers.replies}")
        yield image, answers.replies[0].pixels
