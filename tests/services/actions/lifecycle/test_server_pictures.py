"""A goal that takes pictures, through its whole life, against a fake bridge and a fake camera in virtual time."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from jezero.base.frames import Vec3
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas.actions import Accepted, Cancel, Feedback, GetRunning, Pause, Rejected, Result, Resume
from jezero.schemas.commands import Phase, Release
from jezero.schemas.goals import GetImagesGoal, ImagesFeedback, ImagesResult, MoveFeedback
from jezero.schemas.images import GetImage
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.topics import SETPOINT
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.motion.behaviour import Done, Move, Plan, VehicleState
from jezero.services.actions.motion.capture import Capture
from tests.services.actions.fake_bridge import FakeBridge
from tests.services.actions.fake_camera import SIDE_PX, FakeCamera
from tests.services.actions.lifecycle.bench import GRANTED, HOVER, Bench, Hovers, calls, published, replies
from tests.services.actions.rig import FAR

ACTION = Action("snap", GetImagesGoal, ImagesFeedback, ImagesResult, Phase.GET_IMAGES, takes_pictures=True)
CONFIG = ActionsConfig()
PERIOD_NS = 300_000_000


class Snap:
    """Stands still in the air and takes a picture every 0.3 s."""

    def __init__(self, capture: Capture, t_ns: int, state: VehicleState) -> None:
        self._capture = capture
        self._asked = 0
        self._start_ns = t_ns

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if self._asked < self._capture.planned and t_ns >= self._start_ns + self._asked * PERIOD_NS:
            self._capture.request(self._asked, t_ns)
            self._asked += 1
        if self._asked == self._capture.planned and not self._capture.is_waiting:
            return Done("succeeded")
        feedback = ImagesFeedback(pos_uav_ned_m=state.pos_uav_ned_m, taken=0, planned=0)
        return Move(Phase.GET_IMAGES, feedback, vel_ned_mps=(0.0, 0.0, 0.0), pitch_camera_rad=-1.0)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> ImagesResult:
        return ImagesResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m, images=self._capture.images())


class SnapPlanner:
    """Plans as many pictures as the goal wants."""

    def plan(self, goal: GetImagesGoal, status: Status) -> Plan:
        capture = Capture(CONFIG.capture, CONFIG.vehicle.airframe, goal.num_images, stream=goal.stream_images)
        return Plan(partial(Snap, capture), capture=capture, check_inputs=lambda state: capture.refusal())


class World:
    """A bus with a bridge, a camera and one action server."""

    def __init__(self, pictures: PictureStore | None = None) -> None:
        self.bus = MemoryBus(seed=1)
        self.bridge = FakeBridge((0.0, 0.0, -3.0))
        self.camera = FakeCamera()
        self.server = ActionServer(ACTION, SnapPlanner(), CONFIG, 5, pictures)
        for service in (self.bridge, self.camera, self.server):
            self.bus.add(service)
        self.bus.run_for(0.5)

    def send(self, num_images: int, *, stream: bool = True) -> SentRequest:
        goal = GetImagesGoal(
            goal_id="g", center_ned_m=(0.0, 0.0, -3.0), radius_m=1.0, num_images=num_images, stream_images=stream
        )
        return self.bus.send_request(ACTION.endpoint, goal)

    def end(self, answers: SentRequest, within_s: float = 30.0) -> Any:
        assert self.bus.run_for(within_s, lambda: answers.ended), answers.replies[-3:]
        return answers.replies[-1]

    def picture(self, index: int) -> Any:
        answers = self.bus.send_request(ACTION.image, GetImage(goal_id="g", index=index))
        self.bus.run_for(0.1)
        assert len(answers.replies) == 1
        return answers.replies[0]


def feedback_of(answers: SentRequest) -> list[ImagesFeedback]:
    return [reply.feedback for reply in answers.replies if isinstance(reply, Feedback)]


def test_pictures_are_told_as_taken_and_their_pixels_come_one_by_one() -> None:
    world = World()
    answers = world.send(4)
    world.bus.run_for(1.5, lambda: any(f.images for f in feedback_of(answers)))
    first = next(f.images[0] for f in feedback_of(answers) if f.images)
    during = world.picture(first.index)
    result = world.end(answers)
    assert isinstance(answers.replies[0], Accepted)
    assert result.outcome == "succeeded"
    assert [image.index for image in result.result.images] == [0, 1, 2, 3]
    assert [image.index for f in feedback_of(answers) for image in f.images] == [0, 1, 2, 3]
    assert (feedback_of(answers)[-1].taken, feedback_of(answers)[-1].planned) == (4, 4)
    assert len(during.pixels) == 3 * SIDE_PX * SIDE_PX
    pictures = [world.picture(index) for index in range(4)]
    assert len({picture.pixels[0] for picture in pictures}) == 4
    assert pictures[0] == during
    assert "no picture 4" in world.picture(4).reason
    assert set(world.camera.pitches_rad) == {-1.0}


def test_without_streaming_only_the_result_tells_of_pictures() -> None:
    world = World()
    answers = world.send(2, stream=False)
    result = world.end(answers)
    assert [image.index for image in result.result.images] == [0, 1]
    assert all(f.images == () for f in feedback_of(answers))


def test_after_a_pause_the_missing_pictures_are_taken() -> None:
    world = World()
    answers = world.send(4)
    assert world.bus.run_for(3.0, lambda: any(f.images for f in feedback_of(answers)))
    world.bus.send_request(ACTION.pause, Pause(goal_id="g"))
    world.bus.run_for(CONFIG.capture.late_max_s + 1.0)
    assert feedback_of(answers)[-1].taken < 4
    world.bus.send_request(ACTION.resume, Resume(goal_id="g"))
    result = world.end(answers)
    assert result.outcome == "succeeded", result.reason
    assert [image.index for image in result.result.images] == [0, 1, 2, 3]


def test_other_clients_read_the_pictures_of_a_goal_that_flies() -> None:
    world = World()
    answers = world.send(100)
    assert world.bus.run_for(3.0, lambda: any(f.images for f in feedback_of(answers)))
    read = world.bus.send_request(ACTION.running, GetRunning())
    assert world.bus.run_for(0.1, lambda: read.ended)
    assert [image.index for image in read.replies[0].images][:1] == [0]


def hover_with_pictures() -> Bench:
    """A bench whose goals may take four pictures, and report none."""
    capture = Capture(CONFIG.capture, CONFIG.vehicle.airframe, 4)
    return Bench(replace(HOVER, takes_pictures=True), Hovers({"capture": capture}))


def test_a_goal_that_takes_pictures_may_report_something_else() -> None:
    bench = hover_with_pictures()
    (feedback,) = replies(bench.fly(FAR) + bench.step(0.1), Feedback)
    assert isinstance(feedback.feedback, MoveFeedback)


def test_an_action_that_may_take_pictures_flies_a_goal_that_takes_none() -> None:
    bench = Bench(replace(HOVER, takes_pictures=True), Hovers())
    assert published(bench.fly(FAR), SETPOINT)


def test_a_goal_with_pictures_that_is_canceled_before_its_first_setpoint_is_released() -> None:
    bench = hover_with_pictures()
    bench.request(FAR)
    bench.respond(bench.step(flies=False), GRANTED)
    bench.request(Cancel(goal_id="far"))
    bench.step(flies=False)
    bench.give_control()
    outputs = bench.step()
    assert [call.payload.outcome for call in calls(outputs, Release)] == ["canceled"]  # type: ignore[attr-defined]
    assert not published(outputs, SETPOINT) and not replies(outputs, Feedback)


def test_without_a_camera_the_goal_is_refused() -> None:
    world = World()
    world.bus.remove("camera")
    reply = world.end(world.send(2))
    assert isinstance(reply, Rejected)
    assert reply.reason.startswith("no pictures: the camera sends none")
    assert world.bridge.grants == 0


def test_a_camera_that_falls_silent_ends_the_goal_and_what_was_taken_stays() -> None:
    world = World()
    answers = world.send(100)
    world.bus.run_for(3.0)
    world.camera.mute = True
    result = world.end(answers)
    assert isinstance(result, Result)
    assert result.outcome == "aborted"
    assert result.reason.startswith("no pictures: none came for point")
    assert result.result is not None and len(result.result.images) > 3
    assert world.picture(0).pixels


def test_a_full_disk_ends_the_goal_with_its_reason(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("no folder")
    world = World(PictureStore(file / "pictures"))
    result = world.end(world.send(3))
    assert result.outcome == "aborted"
    assert "no pictures: they can't be stored: Not a directory" in result.reason


def test_an_idle_server_hears_no_pictures() -> None:
    world = World()
    assert world.bus._ports["snap"].subscribed == {"status", "clock", "fence"}
    world.end(world.send(1))
    assert world.bus._ports["snap"].subscribed == {"status", "clock", "fence"}


@pytest.mark.parametrize("goal_id", ["..", "a/b", ""])
def test_questions_for_strange_goals_are_answered_with_a_reason(goal_id: str) -> None:
    world = World()
    answers = world.bus.send_request(ACTION.image, GetImage(goal_id=goal_id, index=0))
    world.bus.run_for(0.1)
    assert answers.replies[0].reason
