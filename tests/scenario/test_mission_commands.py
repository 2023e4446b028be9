"""Commands to missions while their goals end or fly on alone, with a point mass in virtual time."""

from typing import Any

import msgspec
import pytest

from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.mission import GoalStep, Mission, MissionCommand, MissionProgress, MissionReply
from jezero.schemas.state import Status, StatusCode
from jezero.trials.campaign.worlds import POINT_MASS
from jezero.trials.stack import mission_maker
from jezero.vehicle_config import VehicleConfig
from tests.scenario.mission_rig import TAKEOFF, go


class PointMassFlight:
    """A mission that has been sent to a vehicle on the ground."""

    def __init__(self, *steps: GoalStep) -> None:
        self.bus: MemoryBus = POINT_MASS.make_bus(1)
        makers = POINT_MASS.make_service_makers(1)
        for name in ("point_mass", "vehicle_bridge", "takeoff", "go_to", "return_home"):
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
    assert flight.status.odometry is not None
    assert flight.status.odometry.pos_uav_ned_m[0] < 15.0


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
