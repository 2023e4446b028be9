"""Mapping an area with a point mass and a camera: pictures along the path, refusals, resuming, the rover's frame."""

from math import dist, hypot
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.codec import decode
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Cancel, Feedback, Rejected, Result
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import AreaCoverageGoal, CoverageResult
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import AREA_COVERAGE
from jezero.services.actions.area_coverage.behaviour import AreaCoverage
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Behaviour, Done, Preparation, Refusal, VehicleState
from jezero.services.actions.table import action_server
from tests.services.actions.fake_bridge import FakeBridge
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.test_behaviours import plan_of

CONFIG = ActionsConfig()
SQUARE = ((1.0, 0.0), (3.0, 0.0), (3.0, 2.0), (1.0, 2.0))
GOAL = AreaCoverageGoal(goal_id="map", polygon_ned_m=SQUARE, z_ned_m=-4.0, resolution_m=0.5, start_ned_m=(1.0, 0.0))


class World:
    """A bus with a hovering vehicle, a camera and the server, half a second old."""

    def __init__(self) -> None:
        self.bus = MemoryBus(seed=1)
        self.bridge = FakeBridge((0.0, 0.0, -3.0))
        self.camera = FakeCamera()
        for service in (self.bridge, self.camera, action_server("area_coverage", 5, CONFIG)):
            self.bus.add(service)
        self.bus.run_for(0.5)

    def send(self, goal: AreaCoverageGoal) -> SentRequest:
        return self.bus.send_request(topics.AREA_COVERAGE.endpoint, goal)

    def end(self, answers: SentRequest, within_s: float = 120.0) -> Any:
        assert self.bus.run_for(within_s, lambda: answers.ended), answers.replies[-3:]
        return answers.replies[-1]

    def cancel_after(self, pictures: int) -> CoverageResult:
        """Fly GOAL until feedback reports a number of pictures, then cancel it; returns its result."""
        answers = self.send(GOAL)
        self.bus.run_for(60.0, lambda: taken(answers) >= pictures)
        self.bus.send_request(topics.AREA_COVERAGE.cancel, Cancel(goal_id=GOAL.goal_id))
        result = self.end(answers)
        assert result.outcome == "canceled"
        return result.result  # type: ignore[no-any-return]


def taken(answers: SentRequest) -> int:
    return max((reply.feedback.taken for reply in answers.replies if isinstance(reply, Feedback)), default=0)


def test_an_area_is_covered_with_a_picture_at_every_planned_point() -> None:
    world, plan = World(), plan_coverage(GOAL, CONFIG)
    answers = world.send(GOAL)
    codes: list[int] = []
    world.bus.observe(lambda t, name, data: codes.append(world.bridge.code) if name == "status" else None)
    result = world.end(answers)
    assert isinstance(result, Result) and result.outcome == "succeeded", result
    assert isinstance(result.result, CoverageResult)
    images = result.result.images
    assert [image.index for image in images] == list(range(len(plan.pictures_m)))
    assert max(dist(i.pos_uav_ned_m[:2], p) for i, p in zip(images, plan.pictures_m, strict=True)) < 0.2
    assert all(abs(image.pos_uav_ned_m[2] + 4.0) < 0.1 for image in images)
    assert result.result.covered > 0.97 and result.result.resume is None
    assert StatusCode.COVERAGE in codes
    mapping = [s for s in world.bridge.setpoints if s.pos_ned_m is None]
    assert 90 < len(mapping) / ((mapping[-1].t_ns - mapping[0].t_ns) / 1e9) < 160
    assert len({round(s.yaw_rad or 0.0, 6) for s in mapping}) == 1


def test_a_canceled_coverage_returns_the_goal_that_takes_the_missing_pictures() -> None:
    world, planned = World(), len(plan_coverage(GOAL, CONFIG).pictures_m)
    first = world.cancel_after(7)
    assert first.resume is not None and first.resume.first_picture == len(first.images) < planned
    second = world.end(world.send(first.resume))
    assert second.outcome == "succeeded"
    assert [i.index for i in (*first.images, *second.result.images)] == list(range(planned))
    assert first.covered < 0.6 and second.result.covered > 0.97


def test_the_missing_part_moves_along_when_the_autopilot_corrects_its_position() -> None:
    world = World()
    answers = world.send(GOAL)
    world.bus.run_for(60.0, lambda: taken(answers) >= 3)
    world.bridge.step_position((0.5, -0.25, 0.1))
    world.bus.run_for(1.0)
    world.camera.mute = True
    result = world.end(answers)
    assert result.outcome == "aborted" and result.reason.startswith("no pictures")
    assert result.result.resume.polygon_ned_m[1] == pytest.approx((3.5, -0.25))
    assert result.result.resume.z_ned_m == pytest.approx(-3.9)


def test_the_feedback_topic_shows_that_a_goal_is_being_planned_before_it_is_accepted() -> None:
    world = World()
    phases: list[str] = []
    topic = topics.feedback_of(topics.AREA_COVERAGE)
    world.bus.observe(
        lambda t, name, data: phases.append(decode(topic.type, data).feedback.phase) if name == topic.name else None
    )
    answers = world.send(GOAL)
    assert world.bus.run_for(3.0, lambda: bool(answers.replies))
    assert isinstance(answers.replies[0], Accepted)
    assert phases.count("planning") >= 2
    assert set(phases) <= {"planning", "flying"}
    first = phases.index("flying") if "flying" in phases else len(phases)
    assert set(phases[:first]) == {"planning"}


def test_a_cancel_does_not_wait_for_the_plan() -> None:
    world = World()
    answers = world.send(GOAL)
    world.bus.run_for(0.3)
    world.bus.send_request(topics.AREA_COVERAGE.cancel, Cancel(goal_id=GOAL.goal_id))
    canceled_ns = world.bus.t_ns
    reply = world.end(answers, 2.0)
    assert isinstance(reply, Rejected) and reply.reason == "canceled by a client"
    assert world.bus.t_ns - canceled_ns < 150_000_000
    assert world.bridge.grants == 0


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"polygon_ned_m": ((0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0))}, "crosses or touches itself"),
        ({"polygon_ned_m": ()}, "0 different corners: three are the least"),
        ({"polygon_ned_m": ((0.0, 0.0), (300.0, 0.0), (300.0, 300.0), (0.0, 300.0))}, "take a coarser resolution"),
        ({"polygon_ned_m": ((0.0, 0.0), (900.0, 0.0), (900.0, 0.5))}, "beyond the limit of 500 m"),
        ({"z_ned_m": 4.0}, "5 m up is −5"),
        ({"z_ned_m": -130.0}, "beyond the limit of 120 m"),
        ({"resolution_m": None}, "give a resolution above 0 m"),
        ({"overlap": 0.7}, "choose one of them"),
        ({"speed_mps": 50.0}, "speed 50 m/s"),
        ({"first_picture": 500}, "there is no picture 500: this coverage has"),
        ({"first_picture": 3, "start_ned_m": None}, "needs the start_ned_m of the one before"),
        ({"holes_ned_m": (((5.0, 5.0), (6.0, 5.0), (6.0, 6.0)),)}, "hole 1 is not wholly inside"),
    ],
)
def test_what_can_not_be_flown_is_refused_with_the_reason(changed: dict[str, Any], why: str) -> None:
    world = World()
    fields = {name: getattr(GOAL, name) for name in GOAL.__struct_fields__}
    reply = world.end(world.send(AreaCoverageGoal(**{**fields, **changed})))
    assert isinstance(reply, Rejected)
    assert why in reply.reason
    assert world.bridge.grants == 0


@pytest.mark.parametrize("after_s", [0.01, 0.6])
def test_a_vehicle_whose_position_is_lost_before_control_is_asked_for_is_not_flown(after_s: float) -> None:
    world = World()
    world.bridge.mute_odometry = True
    answers = world.send(GOAL)
    world.bus.run_for(after_s)
    assert not answers.ended
    world.bridge.lost = True
    reply = world.end(answers)
    assert isinstance(reply, Rejected)
    assert "position is not known any more" in reply.reason
    assert world.bridge.grants == 0


# -- the rover's frame --


def from_rover(pos_uav_ned_m: tuple[float, float, float], *, valid: bool = True) -> VehicleState:
    """A hovering vehicle at (10, 5, -3), of which the estimator says where it is relative to the rover."""
    relative = Relative(
        t_ns=0,
        epoch_id=1,
        pos_uav_rel_rover_ned_m=pos_uav_ned_m,
        vel_uav_rel_rover_ned_mps=(0.0, 0.0, 0.0),
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=0.0,
        yaw_rate_rover_rps=0.0,
        cov=(0.0,) * 21,
        use_uwb=True,
        use_tag=True,
        valid=valid,
        reason="" if valid else "the rover is out of sight",
    )
    return VehicleState(
        (10.0, 5.0, -3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, relative=relative
    )


def started(prepared_in: VehicleState, started_in: VehicleState) -> Behaviour:
    """The behaviour of a goal in the rover's frame, prepared in one state and started in another."""
    goal = AreaCoverageGoal(polygon_ned_m=SQUARE, z_ned_m=-4.0, resolution_m=0.5, frame="rover")
    plan = plan_of(AREA_COVERAGE, goal)
    assert isinstance(plan.start, Preparation) and plan.inputs == (topics.RELATIVE,)
    prepared = plan.start.start(plan.start.work(prepared_in)())
    assert not isinstance(prepared, Refusal)
    return prepared.start(0, started_in)


def test_in_the_rovers_frame_the_area_stays_where_it_was_at_the_begin() -> None:
    begin = from_rover((2.0, 1.0, -2.5))
    behaviour = started(begin, begin)
    for seconds in range(1, 20):
        move = behaviour.step(seconds * 100_000_000, from_rover((2.0 - seconds, 1.0, -2.5)))
        assert not isinstance(move, Done)
        north_m, east_m, down_m = move.pos_ned_m or (0.0, 0.0, 0.0)
        assert hypot(north_m - 10.0, east_m - 5.0) < 2.5
        assert move.feedback.pos_uav_ned_m == pytest.approx((2.0, 1.0, -2.5))
    assert down_m < -3.0
    result = behaviour.result(False, (0.0, 0.0, 0.0))
    assert isinstance(result, CoverageResult)
    resume = result.resume
    assert resume is not None and resume.frame == "world"
    assert resume.polygon_ned_m[0] == pytest.approx((9.0, 4.0)) and resume.z_ned_m == pytest.approx(-4.5)


def test_a_rover_that_is_lost_before_the_begin_ends_the_goal() -> None:
    lost = from_rover((2.0, 1.0, -2.5), valid=False)
    behaviour = started(from_rover((2.0, 1.0, -2.5)), lost)
    done = behaviour.step(1, lost)
    assert isinstance(done, Done) and done.outcome == "aborted"
    assert "the rover is out of sight" in done.reason


def test_the_direction_and_the_images_of_an_area_under_way_change_with_the_area_only() -> None:
    begin = VehicleState((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, False)
    plan = plan_of(AREA_COVERAGE, GOAL)
    assert isinstance(plan.start, Preparation)
    prepared = plan.start.start(plan.start.work(begin)())
    assert not isinstance(prepared, Refusal)
    running = prepared.start(0, begin)
    assert isinstance(running, AreaCoverage)
    for fields in ({"angle_rad": 1.0}, {"picture_distance_m": 0.25}):
        refusal = running.changed(replace(GOAL, **fields))
        assert isinstance(refusal, Refusal) and "keep their direction and distance" in refusal.reason
        elsewhere = running.changed(replace(GOAL, polygon_ned_m=SQUARE[:3], **fields))
        assert isinstance(elsewhere, AreaCoverageGoal)
    assert isinstance(running.changed(replace(GOAL, speed_mps=0.5)), AreaCoverageGoal)
