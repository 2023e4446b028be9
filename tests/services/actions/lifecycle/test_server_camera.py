"""An action without pictures that points the camera, on the bus in virtual time."""

import pytest

from jezero.base.frames import Vec3
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas.actions import Result
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.topics import CAMERA_PITCH
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.server import ActionServer
from jezero.services.actions.motion.behaviour import Done, Move, Plan, VehicleState
from tests.services.actions.fake_bridge import FakeBridge
from tests.services.actions.fake_camera import FakeCamera


class Look:
    """Hovers for a second with the camera at a pitch."""

    def __init__(self, pitch_camera_rad: float, t_ns: int, state: VehicleState) -> None:
        self._pitch_camera_rad = pitch_camera_rad
        self._end_ns = t_ns + 1_000_000_000

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        if t_ns > self._end_ns:
            return Done("succeeded")
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=0.0)
        hover_mps = (0.0, 0.0, 0.0)
        return Move(Phase.ACTION, feedback, vel_ned_mps=hover_mps, pitch_camera_rad=self._pitch_camera_rad)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> MoveResult:
        return MoveResult(completed=completed, pos_uav_ned_m=pos_uav_ned_m)


class LookPlanner:
    """Points the camera by the goal's heading, as a number that may be wrong."""

    def plan(self, goal: GoToGoal, status: Status) -> Plan:
        return Plan(lambda t_ns, state: Look(goal.yaw_rad or 0.0, t_ns, state))


class World:
    def __init__(self, *, points_camera: bool) -> None:
        action = Action("look", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION, points_camera=points_camera)
        self.bus, self.camera, self.action = MemoryBus(seed=1), FakeCamera(), action
        for service in (
            FakeBridge((0.0, 0.0, -3.0)),
            self.camera,
            ActionServer(action, LookPlanner(), ActionsConfig(), 5),
        ):
            self.bus.add(service)
        self.bus.run_for(0.5)

    def end(self, pitch_rad: float) -> Result[MoveResult]:
        replies = self.bus.send_request(self.action.endpoint, GoToGoal(target_ned_m=(0.0, 0.0, 0.0), yaw_rad=pitch_rad))
        assert self.bus.run_for(10.0, lambda: replies.ended), replies.replies[-3:]
        result = replies.replies[-1]
        assert isinstance(result, Result)
        return result


def test_an_action_that_declares_it_points_the_camera() -> None:
    world = World(points_camera=True)
    assert world.end(-0.5).outcome == "succeeded"
    assert set(world.camera.pitches_rad) == {-0.5}


def test_the_camera_gets_its_pitch_less_often_than_the_vehicle_its_setpoints() -> None:
    """The goal lasts a second, with fifty setpoints."""
    world = World(points_camera=True)
    world.end(-0.5)
    assert CAMERA_PITCH.rate_hz is not None
    assert 0.7 * CAMERA_PITCH.rate_hz < len(world.camera.pitches_rad) < 1.1 * CAMERA_PITCH.rate_hz


@pytest.mark.parametrize(
    ("points_camera", "pitch_rad", "sentence"),
    [
        (False, -0.5, "look failed in step: Move.pitch_camera_rad points the camera: declare the Action with"),
        (True, 0.5, "look failed in step: Move: pitch_camera_rad: expected"),
    ],
)
def test_a_camera_that_is_not_declared_or_out_of_range_ends_the_goal_and_not_the_server(
    points_camera: bool, pitch_rad: float, sentence: str
) -> None:
    world = World(points_camera=points_camera)
    for _ in range(2):
        result = world.end(pitch_rad)
        assert result.outcome == "aborted" and result.reason.startswith(sentence)
    assert not world.camera.pitches_rad


def test_only_an_action_that_points_the_camera_declares_its_topic() -> None:
    for points_camera in (False, True):
        action = Action("look", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION, points_camera=points_camera)
        spec = ActionServer(action, LookPlanner(), ActionsConfig(), 5).spec
        assert (CAMERA_PITCH in spec.outputs) == points_camera
