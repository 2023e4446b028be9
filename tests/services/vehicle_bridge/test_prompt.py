"""What the bridge does first: odometry for the goal that waits for it, and the setpoint that answers it."""

from typing import Any

import pytest

from jezero.mavlink import dialect
from jezero.runtime.service import Output, Publish, Send
from jezero.schemas.commands import Hover, Phase
from jezero.schemas.topics import HOVER, ODOMETRY, STATUS
from tests.services.vehicle_bridge.rig import MODES, Rig

MS = 1_000_000


class Moments:
    """A goal in flight, seen a millisecond at a time."""

    def __init__(self) -> None:
        self.rig = Rig().fly()
        self.control_id = self.rig.go("go_to", Phase.GO_TO)
        self.setpoints = len(self.rig.autopilot.setpoints)

    def pass_ms(self, ms: int, *, told: bytes = b"", setpoint: bool = False, **fields: Any) -> list[Output]:
        """One step after so long; what it yields."""
        rig = self.rig
        rig.t_ns += ms * MS
        rig.box.wall_ns += ms * MS
        rig.box.bytes = told
        if setpoint:
            rig.setpoint(self.control_id, Phase.GO_TO, **fields)
        before = len(rig.outputs)
        for output in rig.bridge.step(rig.t_ns, rig.box):
            rig._take(output)
        rig.box.clear()
        return rig.outputs[before:]

    def odometry(self, **changes: Any) -> bytes:
        autopilot = self.rig.autopilot
        vars(autopilot).update(changes)
        nan = [float("nan")] * 21
        pose = (*autopilot.pos, autopilot.q, *autopilot.vel, 0.0, 0.0, 0.0, nan, nan, autopilot.reset_counter, 8, 100)
        return autopilot.codec.pack(dialect.MAVLink_odometry_message(self.rig.t_ns // 1000 + 1000, 1, 1, *pose))

    def beat(self, mode: str) -> bytes:
        self.rig.autopilot.mode = MODES[mode]
        return self.rig.autopilot.codec.pack(dialect.MAVLink_heartbeat_message(2, 12, 129, MODES[mode], 4, 3))

    @property
    def flown(self) -> int:
        """Setpoints sent so far."""
        return len(self.rig.autopilot.setpoints) - self.setpoints


def topics_of(outputs: list[Output]) -> list[str]:
    return [output.topic.name for output in outputs if isinstance(output, Publish)]


def test_while_a_goal_flies_odometry_goes_out_and_the_rest_waits_for_the_setpoint() -> None:
    moments, told = Moments(), 0
    for _ in range(20):
        assert topics_of(moments.pass_ms(19, told=moments.odometry())) == [ODOMETRY.name]
        first, *others = moments.pass_ms(1, setpoint=True)
        assert isinstance(first, Send)
        told += topics_of(others).count(STATUS.name)
    assert moments.flown == 20
    assert told == pytest.approx(4, abs=1)


def test_without_setpoints_the_rest_waits_for_the_next_step_only() -> None:
    moments = Moments()
    told = [topics_of(moments.pass_ms(20, told=moments.odometry())) for _ in range(12)]
    assert told[0] == [ODOMETRY.name]
    assert sum(STATUS.name in topics for topics in told) >= 2
    assert moments.rig.status.code == 4
    for _ in range(6):
        moments.pass_ms(20, told=moments.odometry())
    assert "sent no setpoint" in moments.rig.status.text


@pytest.mark.parametrize("together", [False, True])
def test_a_takeover_that_was_told_is_seen_before_the_next_setpoint_is_flown(together: bool) -> None:
    moments = Moments()
    outputs = moments.pass_ms(20, told=moments.odometry() + moments.beat("POSCTL"), setpoint=together)
    assert topics_of(outputs)[0] == ODOMETRY.name
    assert moments.rig.status.code == 13
    moments.pass_ms(1, setpoint=True)
    assert moments.flown == 0


def test_a_position_that_was_reset_moves_the_setpoint_that_is_still_of_before() -> None:
    moments = Moments()
    moments.pass_ms(20, told=moments.odometry(pos=[1.0, 0.0, -2.0], reset_counter=1))
    moments.pass_ms(1, setpoint=True, reset_counter=0, pos_ned_m=(0.0, 0.0, -2.0))
    assert moments.rig.autopilot.setpoints[-1].x == pytest.approx(1.0)


def test_a_question_makes_everything_that_was_told_be_looked_at() -> None:
    moments = Moments()
    moments.pass_ms(20, told=moments.odometry(pos=[3.0, 0.0, -2.0]))
    moments.rig.post(HOVER, Hover())
    moments.pass_ms(1)
    assert moments.rig.status.code in (3, 12)
    assert moments.rig.autopilot.setpoints[-1].x == pytest.approx(3.0)


def test_setpoints_alone_do_not_keep_the_loss_of_telemetry_from_being_seen() -> None:
    moments = Moments()
    for _ in range(120):
        moments.pass_ms(10, setpoint=True)
    assert moments.rig.status.code in (3, 12)
    assert "no telemetry" in moments.rig.status.text


def test_a_hovering_vehicle_is_looked_at_with_each_odometry() -> None:
    moments = Moments()
    assert moments.rig.release(moments.control_id, "canceled").released
    assert topics_of(moments.pass_ms(200, told=moments.odometry())) == [ODOMETRY.name, STATUS.name]
