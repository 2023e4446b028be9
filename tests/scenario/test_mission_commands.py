"""Commands to missions, and steps that are refused, with a point mass in virtual time."""

from typing import Any

import msgspec
import pytest

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.mission import GoalStep, Mission, MissionCommand, MissionProgress, MissionReply
from jezero.schemas.state import Status, StatusCode
from jezero.trials.campaign.models import POINT_MASS
from jezero.trials.stack import mission_maker
from tests.scenario.mission_rig import TAKEOFF, go


class PointMassFlight:
    """A mission that has been sent to a vehicle on the ground."""

    def __init__(self, *steps: GoalStep) -> None:
        self.bus: MemoryBus = POINT_MASS.make_bus(1)
        makers = POINT_MASS.make_service_makers(1)
        for name in ("point_mass", "vehicle_bridge", "takeoff", "go_to", "land_on_spot", "return_home"):
            self.bus.add(makers[name](1))
        self._make_mission = mission_maker(VehicleConfig())
        self.bus.add(self._make_mission(1))
        self.bus.observe(self._observe)
        self.bus.run_for(15.0)
        assert self.ask(topics.RUN_MISSION, Mission(name="test", steps=(TAKEOFF, *steps))).accepted

    def restart(self) -> None:
        """End the mission service and start it again, while the second step flies."""
        self.wait(lambda: self.progress.step == 2 and self.status.code == StatusCode.GO_TO)
        self.bus.run_for(1.0)
        self.bus.remove("mission")
        self.bus.run_for(1.0)
        self.bus.add(self._make_mission(2))
        self.wait(lambda: self.progress.state == "interrupted")

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.MISSION.name:
            self.progress = msgspec.json.decode(data, type=MissionProgress)
        elif topic == topics.STATUS.name:
            self.status = msgspec.json.decode(data, type=Status)

    @property
    def pos_ned_m(self) -> Vec3:
        assert self.status.odometry is not None
        return self.status.odometry.pos_uav_ned_m

    def wait(self, condition: Any) -> None:
        assert self.bus.run_for(60.0, condition), (self.progress, self.status)

    def ask(self, endpoint: Any, payload: Any) -> MissionReply:
        sent = self.bus.send_request(endpoint, payload)
        self.wait(lambda: sent.ended)
        reply: MissionReply = sent.replies[-1]
        return reply


@pytest.mark.parametrize("known_s", [0.0, 1.0])
@pytest.mark.parametrize(("command", "state"), [("stop", "stopped"), ("skip", "succeeded")])
def test_the_goal_that_flies_on_ends_when_that_is_commanded(command: Any, state: str, known_s: float) -> None:
    flight = PointMassFlight(go(40.0, 0.0), go(3.0, 0.0))
    flight.restart()
    flight.bus.run_for(known_s)  # the vehicle's status is unknown at first
    assert flight.status.code == StatusCode.GO_TO
    assert flight.ask(topics.COMMAND_MISSION, MissionCommand(command=command)).accepted
    flight.wait(lambda: flight.progress.state == state)
    flight.wait(lambda: flight.status.code == StatusCode.HOVER)
    assert flight.pos_ned_m[0] < 15.0


def test_a_mission_that_is_paused_hovers_and_goes_on_where_it_was() -> None:
    flight = PointMassFlight(go(30.0, 0.0))
    flight.wait(lambda: flight.progress.step == 2 and flight.status.code == StatusCode.GO_TO)
    flight.bus.run_for(3.0)
    assert flight.ask(topics.COMMAND_MISSION, MissionCommand(command="pause")).accepted
    flight.wait(lambda: flight.progress.state == "paused")
    flight.bus.run_for(3.0)
    before_m = flight.pos_ned_m
    flight.bus.run_for(10.0)
    assert flight.status.paused and flight.pos_ned_m == pytest.approx(before_m, abs=0.2)
    assert flight.ask(topics.COMMAND_MISSION, MissionCommand(command="resume")).accepted
    flight.wait(lambda: flight.progress.state == "succeeded")
    assert flight.pos_ned_m[0] == pytest.approx(30.0, abs=0.5)
    assert flight.progress.attempt == 1  # the goal itself was paused


def test_after_a_restart_a_resume_goes_on_with_the_goal_that_flies_on() -> None:
    flight = PointMassFlight(go(40.0, 0.0), go(3.0, 0.0))
    flight.restart()
    assert flight.progress.reason == "the mission service was restarted"
    flight.bus.run_for(1.0)
    goal_id = flight.status.goal_id
    assert flight.status.code == StatusCode.GO_TO and goal_id
    assert flight.ask(topics.COMMAND_MISSION, MissionCommand(command="resume")).accepted
    flight.wait(lambda: flight.progress.state == "running" and bool(flight.progress.goal_id))
    assert (flight.progress.step, flight.progress.goal_id) == (2, goal_id)
    flight.wait(lambda: flight.progress.state == "succeeded")
    assert flight.progress.step == 3


def test_a_stop_is_not_overruled_by_a_skip_before_the_goal_has_ended() -> None:
    flight = PointMassFlight(go(40.0, 0.0), go(3.0, 0.0))
    flight.restart()
    stop, skip = (
        flight.bus.send_request(topics.COMMAND_MISSION, MissionCommand(command=command)) for command in ("stop", "skip")
    )
    flight.wait(lambda: stop.ended and skip.ended)
    assert stop.replies[-1].accepted
    assert "still ending" in skip.replies[-1].reason
    flight.wait(lambda: flight.progress.state == "stopped")


def test_a_mission_that_is_paused_on_its_last_way_still_says_why_it_fails() -> None:
    flight = PointMassFlight(go(9000.0, 0.0, then="return"))
    flight.wait(lambda: flight.progress.label == "return home" and flight.status.action == "return_home")
    flight.bus.run_for(1.0)
    assert flight.ask(topics.COMMAND_MISSION, MissionCommand(command="pause")).accepted
    assert flight.ask(topics.COMMAND_MISSION, MissionCommand(command="resume")).accepted
    flight.wait(lambda: flight.progress.state == "failed")
    assert "9000" in flight.progress.reason


@pytest.mark.parametrize(
    ("then", "state", "step", "on_ground"),
    [("stop", "failed", 2, False), ("skip", "succeeded", 3, False), ("return", "failed", 2, True),
     ("land", "failed", 2, True)],
)  # fmt: skip
def test_a_step_that_is_refused_ends_as_its_policy_says(then: str, state: str, step: int, on_ground: bool) -> None:
    flight = PointMassFlight(go(9000.0, 0.0, retries=1, then=then), go(1.0, 0.0))
    flight.wait(lambda: flight.progress.state == state)
    assert flight.progress.step == step
    assert flight.status.landed == on_ground
    if state == "failed":
        assert "9000" in flight.progress.reason
