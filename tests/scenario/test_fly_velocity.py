"""A flight by velocity with full physics, in virtual time: a square, the loss of its commands, the fence."""

from collections.abc import Iterator

import msgspec
import pytest

from jezero.base.frames import Vec3, distance
from jezero.base.mavlink import dialect
from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.actions import Feedback
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.fence import Fence, FenceReply, SetFence, Zone
from jezero.schemas.goals import FlyVelocityGoal, GoToGoal
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge import autopilot_link
from tests.scenario.rig import Flight

FIELD = Zone(name="field", corners_ned_m=((-8.0, -8.0), (12.0, -8.0), (12.0, 12.0), (-8.0, 12.0)))


class Stick:
    """A client that publishes a command twenty times a second; None publishes none."""

    spec = Spec(name="stick", outputs=(topics.VELOCITY_COMMAND,), rate_hz=20.0)

    def __init__(self) -> None:
        self.command: VelocityCommand | None = None

    def hold(self, **fields: float | bool) -> None:
        self.command = VelocityCommand(t_ns=0, goal_id="stick", **fields)  # type: ignore[arg-type]

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        if self.command is not None:
            yield Publish(topics.VELOCITY_COMMAND, msgspec.structs.replace(self.command, t_ns=t_ns))


@pytest.mark.parametrize("odometry_hz", [50.0, topics.FLY_VELOCITY.odometry_min_hz / 2.0])
def test_a_square_by_velocity_then_silence_and_the_fence(odometry_hz: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(autopilot_link.INTERVALS_US, dialect.MAVLINK_MSG_ID_ODOMETRY, int(1e6 / odometry_hz))
    flight, stick = Flight(seed=3), Stick()
    flight.bus.add(stick)
    flight.wait_ready()
    fence = Fence(name="mars", keep_in=FIELD, ceiling_m=10.0)
    assert flight.request(topics.SET_FENCE, SetFence(fence=fence)) == FenceReply(accepted=True)
    flight.take_off(3.0)
    flight.do(topics.GO_TO, GoToGoal(target_ned_m=(0.0, 0.0, -3.0), yaw_rad=0.0))
    goal = flight.send(topics.FLY_VELOCITY, FlyVelocityGoal(goal_id="stick"))

    def place() -> Vec3:
        return flight.truth.pos_uav_ned_m

    # Each side is 1 m/s for 4 s; without a turn the axes of the heading are north and east.
    corners = []
    for side in ({"forward_mps": 1.0}, {"right_mps": 1.0}, {"forward_mps": -1.0}, {"right_mps": -1.0}):
        stick.hold(**side)
        flight.bus.run_for(4.0)
        stick.hold()
        flight.bus.run_for(2.5)
        corners.append(place())
    expected = [(4.0, 0.0, -3.0), (4.0, 4.0, -3.0), (0.0, 4.0, -3.0), (0.0, 0.0, -3.0)]
    assert [distance(a, b) for a, b in zip(corners, expected, strict=True)] == pytest.approx([0.0] * 4, abs=0.8)

    # The joystick dies at speed: the vehicle comes to rest and keeps its place, and the goal goes on.
    stick.hold(forward_mps=2.0)
    flight.bus.run_for(3.0)
    stick.command = None
    flight.bus.run_for(5.0)
    held = place()
    flight.bus.run_for(3.0)
    assert distance(held, place()) < 0.4 and not goal.ended
    assert flight.status.code == StatusCode.ACTION

    # It flies on, stops in front of the fence, and is never outside.
    before = len(flight.truths)
    stick.hold(forward_mps=3.0, right_mps=3.0, yaw_rate_rps=0.0)
    flight.bus.run_for(20.0)
    north_m, east_m, _ = place()
    assert north_m == pytest.approx(11.0, abs=0.5) and east_m == pytest.approx(11.0, abs=0.5)
    assert all(max(truth.pos_uav_ned_m[:2]) < 11.8 for truth in flight.truths[before:])
    newest = [reply for reply in goal.replies if isinstance(reply, Feedback)][-1].feedback
    assert newest.follows and newest.limited_by == "the area 'field' to stay in"
    assert flight.status.text == "" or "fence" not in flight.status.text  # the bridge had nothing to hold back

    stick.hold(is_last=True)
    assert flight.finish(goal).outcome == "succeeded"
    flight.wait_code(StatusCode.HOVER, 5.0)
