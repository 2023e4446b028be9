"""The action servers and the real vehicle bridge together, over a point mass that speaks MAVLink."""

from collections.abc import Iterator
from typing import Any

import pytest

from jezero.base.codec import decode
from jezero.base.frames import Vec3
from jezero.base.mavlink import dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus, SentRequest
from jezero.runtime.service import Inbox, Output, Publish, Send, Spec
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, Rejected, Result
from jezero.schemas.commands import Abort
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Clock, Status
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.table import PLANNERS, action_server
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge
from tests.services.actions.fake_bridge import follow
from tests.services.vehicle_bridge.rig import FakeAutopilot

DT_S = 0.02
LAND = LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(1.0, 1.0, 0.0))


class PointMass:
    """Autopilot, vehicle and time master in one; obeys setpoints while armed."""

    spec = Spec(name="point_mass", outputs=(topics.CLOCK, topics.ALTIMETER), links=("offboard",), rate_hz=1.0 / DT_S)

    def __init__(self) -> None:
        self.autopilot = FakeAutopilot()
        self.still_s = 1.0
        self.steps = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        autopilot = self.autopilot
        autopilot.t_us = t_ns // 1000
        reply = autopilot.handle(inbox.received("offboard"))
        self._fly()
        yield Send("offboard", reply + autopilot.telemetry())
        if self.steps % 5 == 0:
            yield Publish(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=3, wall_ns=t_ns))
        self.steps += 1
        height_m = -autopilot.pos[2]
        yield Publish(topics.ALTIMETER, Altimeter(t_ns=t_ns, range_m=height_m if height_m > 0.15 else None))

    def _fly(self) -> None:
        autopilot = self.autopilot
        if not autopilot.armed:
            autopilot.setpoints.clear()
            return
        if not autopilot.setpoints:
            return
        setpoint = autopilot.setpoints[-1]
        del autopilot.setpoints[:-1]
        pos: Vec3 | None = (setpoint.x, setpoint.y, setpoint.z)
        vel: Vec3 | None = (setpoint.vx, setpoint.vy, setpoint.vz)
        if setpoint.type_mask & dialect.POSITION_TARGET_TYPEMASK_X_IGNORE:
            pos = None
        if setpoint.type_mask & dialect.POSITION_TARGET_TYPEMASK_VX_IGNORE:
            vel = None
        now_pos, now_vel = (tuple(autopilot.pos), tuple(autopilot.vel))
        now_pos, now_vel = follow(now_pos, now_vel, pos, vel, DT_S)  # type: ignore[arg-type]
        autopilot.pos, autopilot.vel = list(now_pos), list(now_vel)
        self.still_s = self.still_s + DT_S if now_pos[2] == 0.0 and now_vel[2] == 0.0 else 0.0
        autopilot.landed = self.still_s > 1.0


class World:
    """The services, ready to fly.

    Attributes:
        codes: every status code published, in order, each change once.
    """

    def __init__(self) -> None:
        self.bus = MemoryBus(seed=3)
        self.mass = PointMass()
        self.codes: list[int] = []
        self.status: Status | None = None
        self.bus.observe(self._note)
        self.bus.add(self.mass)
        self.bus.add(VehicleBridge(VehicleBridgeConfig(), VehicleConfig(), system_id=1, boot_id=0xB0, secret="s"))
        self.bus.wire(("point_mass", "offboard"), ("vehicle_bridge", "autopilot"), UDP_DELAY)
        for name in PLANNERS:
            self.bus.add(action_server(name, 5, ActionsConfig()))
        assert self.bus.run_for(10.0, lambda: self.status is not None and self.status.ready)

    def _note(self, t_ns: int, name: str, data: bytes) -> None:
        if name == topics.STATUS.name:
            self.status = decode(Status, data)
            if not self.codes or self.codes[-1] != self.status.code:
                self.codes.append(self.status.code)

    def send(self, goal: Any) -> SentRequest:
        action = next(a for a in topics.ACTIONS.values() if a.goal_type is type(goal))
        return self.bus.send_request(action.endpoint, goal)

    def end(self, answers: SentRequest, within_s: float = 60.0) -> Any:
        assert self.bus.run_for(within_s, lambda: answers.ended), (answers.replies[-1], self.status)
        return answers.replies[-1]

    def fly(self, goal: Any) -> Any:
        result = self.end(self.send(goal))
        assert isinstance(result, Result), result
        return result


def test_a_whole_flight_goes_through_the_table_of_the_thesis() -> None:
    world = World()
    assert world.fly(TakeoffGoal(altitude_m=2.0)).outcome == "succeeded"
    assert world.fly(GoToGoal(target_ned_m=(-1.0, -2.0, -3.0))).outcome == "succeeded"
    landing = world.fly(LAND)
    assert landing.outcome == "succeeded"
    assert landing.result.touchdown_ned_m == pytest.approx((1.0, 1.0, 0.0), abs=0.15)
    assert world.codes == [0, 1, 2, 3, 4, 5, 3, 8, 9, 0]
    assert not world.mass.autopilot.armed


def test_a_go_to_from_the_ground_takes_off_first() -> None:
    world = World()
    refused = world.end(world.send(GoToGoal(target_ned_m=(0.0, 0.0, -4.0))))
    assert isinstance(refused, Rejected)
    assert "take off first, or let the goal begin with a takeoff" in refused.reason
    assert world.fly(GoToGoal(target_ned_m=(0.0, 0.0, -4.0), do_takeoff=True)).outcome == "succeeded"
    assert world.codes == [0, 1, 4, 5, 3]
    assert world.mass.autopilot.pos == pytest.approx([0.0, 0.0, -4.0], abs=0.15)


def test_abort_ends_the_goal_with_the_bridges_words() -> None:
    world = World()
    world.fly(TakeoffGoal(altitude_m=2.0))
    answers = world.send(GoToGoal(target_ned_m=(30.0, 0.0, -2.0), goal_id="g"))
    world.bus.run_for(2.0)
    world.bus.send_request(topics.ABORT, Abort(reason="enough"))
    result = world.end(answers, 0.3)
    assert result.outcome == "aborted"
    assert "enough" in result.reason
    world.bus.run_for(1.0)
    assert world.codes[-3:] == [4, 12, 3]
    assert world.fly(LAND).outcome == "succeeded"


@pytest.mark.parametrize("after_s", [0.05, 1.0, 3.0])
def test_a_canceled_takeoff_ends_on_the_ground_or_hovering(after_s: float) -> None:
    world = World()
    answers = world.send(TakeoffGoal(altitude_m=5.0, goal_id="g"))
    world.bus.run_for(after_s)
    world.bus.send_request(topics.TAKEOFF.cancel, Cancel(goal_id="g"))
    result = world.end(answers, 10.0)
    assert result.outcome == "canceled"
    assert world.status is not None
    assert world.status.code in (0, 3)


def test_a_position_reset_in_flight_goes_unnoticed() -> None:
    world = World()
    world.fly(TakeoffGoal(altitude_m=2.0))
    answers = world.send(GoToGoal(target_ned_m=(6.0, 0.0, -2.0), goal_id="g"))
    world.bus.run_for(2.0)
    autopilot = world.mass.autopilot
    autopilot.pos[1] += 0.8
    autopilot.reset_counter = 1
    sideways: list[float] = []

    def has_ended() -> bool:
        sideways.append(autopilot.pos[1])
        return answers.ended

    assert world.bus.run_for(30.0, has_ended)
    assert answers.replies[-1].outcome == "succeeded"
    assert all(abs(y - 0.8) < 0.05 for y in sideways)
    assert answers.replies[-1].result.pos_uav_ned_m == pytest.approx((6.0, 0.8, -2.0), abs=0.15)


def test_arming_that_is_refused_ends_the_goal_with_the_autopilots_words() -> None:
    world = World()
    world.mass.autopilot.refuse_arming = "Arming denied: no GNSS fix yet"
    result = world.fly(TakeoffGoal())
    assert result.outcome == "aborted"
    assert "no GNSS fix yet" in result.reason
    world.bus.run_for(1.0)
    assert world.codes == [0, 1, 12, 0]
