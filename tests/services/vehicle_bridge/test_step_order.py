"""The order within a step: telemetry, requests, safety and time-outs, the setpoint, then odometry and status."""

import pytest

from jezero.base.mavlink import dialect
from jezero.runtime.service import Output, Publish, Send
from jezero.schemas.commands import Hover, Phase
from jezero.schemas.topics import HOVER, ODOMETRY
from tests.services.vehicle_bridge.rig import MODES, Rig

MS = 1_000_000
NO_COVARIANCE = [float("nan")] * 21


class GoalFlight:
    """A goal in flight, stepped a few milliseconds at a time."""

    def __init__(self) -> None:
        self.rig = Rig().fly()
        self.control_id = self.rig.go("go_to", Phase.GO_TO)
        self._sent_before = len(self.rig.autopilot.setpoints)

    def step_after(self, ms: int, data: bytes = b"") -> list[Output]:
        """One step after this time, with these bytes from the autopilot; returns its outputs."""
        rig = self.rig
        rig.t_ns += ms * MS
        rig.box.wall_ns += ms * MS
        rig.box.bytes = data
        before = len(rig.outputs)
        for output in rig.bridge.step(rig.t_ns, rig.box):
            rig._apply(output)
        rig.box.clear()
        return rig.outputs[before:]

    def put_setpoint(self, reset_counter: int = 0) -> None:
        """Put a setpoint at (0, 0, −2) into the next step."""
        self.rig.setpoint(self.control_id, Phase.GO_TO, reset_counter=reset_counter)

    def odometry(self, north_m: float = 0.0, reset_counter: int = 0) -> bytes:
        autopilot = self.rig.autopilot
        motion = (north_m, 0.0, -2.0, autopilot.q, *autopilot.vel, 0.0, 0.0, 0.0)
        return autopilot.codec.pack(
            dialect.MAVLink_odometry_message(
                self.rig.t_ns // 1000 + 1000, 1, 1, *motion, NO_COVARIANCE, NO_COVARIANCE, reset_counter, 8, 100
            )
        )

    def heartbeat(self, mode: str) -> bytes:
        self.rig.autopilot.mode = MODES[mode]
        return self.rig.autopilot.codec.pack(dialect.MAVLink_heartbeat_message(2, 12, 129, MODES[mode], 4, 3))

    @property
    def sent(self) -> int:
        """Number of setpoints that the bridge has sent."""
        return len(self.rig.autopilot.setpoints) - self._sent_before


def test_each_accepted_setpoint_goes_out_at_once_even_when_it_equals_the_last_one() -> None:
    flight = GoalFlight()
    for _ in range(20):
        flight.step_after(19, flight.odometry())
        flight.put_setpoint()
        assert isinstance(flight.step_after(1)[0], Send)
    assert flight.sent == 20


@pytest.mark.parametrize("in_the_same_step", [False, True])
def test_a_takeover_is_digested_before_the_next_setpoint_is_flown(in_the_same_step: bool) -> None:
    flight = GoalFlight()
    if in_the_same_step:
        flight.put_setpoint()
    outputs = flight.step_after(20, flight.odometry() + flight.heartbeat("POSCTL"))
    assert next(output.topic for output in outputs if isinstance(output, Publish)) is ODOMETRY
    assert flight.rig.status.code == 13
    flight.put_setpoint()
    flight.step_after(1)
    assert flight.sent == 0


def test_a_position_reset_is_digested_before_a_setpoint_from_before_it_is_flown() -> None:
    flight = GoalFlight()
    flight.step_after(20, flight.odometry(north_m=1.0, reset_counter=1))
    flight.put_setpoint(reset_counter=0)
    flight.step_after(1)
    assert flight.rig.autopilot.setpoints[-1].x == pytest.approx(1.0)


def test_a_request_is_handled_with_the_newest_odometry() -> None:
    flight = GoalFlight()
    flight.step_after(20, flight.odometry(north_m=3.0))
    flight.rig.post(HOVER, Hover())
    flight.step_after(1)
    assert flight.rig.status.code in (3, 12)
    assert flight.rig.autopilot.setpoints[-1].x == pytest.approx(3.0)


def test_a_stream_of_setpoints_does_not_hide_the_loss_of_telemetry() -> None:
    flight = GoalFlight()
    for _ in range(120):
        flight.put_setpoint()
        flight.step_after(10)
    assert flight.rig.status.code in (3, 12)
    assert "no telemetry" in flight.rig.status.text
