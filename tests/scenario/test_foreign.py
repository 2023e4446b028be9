"""A pilot on the autopilot's ground-station link takes over and gives back, in virtual time."""

from collections.abc import Iterator

import pytest

from jezero.base.frames import norm
from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import UDP_DELAY
from jezero.runtime.service import Inbox, Output, Send, Spec
from jezero.schemas import topics
from jezero.schemas.commands import Hover
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.state import StatusCode as Code
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge
from tests.scenario.rig import Flight, go_to, land_at

POSITION, HOLD, LAND, OFFBOARD = (3.0, 0.0), (4.0, 3.0), (4.0, 6.0), (6.0, 0.0)
VELOCITY_ONLY = 0b110111000111
PERIOD_NS = 50_000_000
HEARTBEAT_BYTES = 21


class Pilot:
    """A ground station like MAVSDK: a heartbeat each second, commands, and setpoints at 20 Hz while it has some."""

    spec = Spec(name="pilot", links=("link",), rate_hz=20.0)

    def __init__(self) -> None:
        self.vel_ned_mps: tuple[float, float, float] | None = None
        self.acknowledged: list[tuple[int, int]] = []
        self._codec = MavlinkCodec(245, 190)
        self._queue: list[MavMessage] = []
        self._next_heartbeat_ns = 0

    def command(self, command: int, *parameters: float) -> None:
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self._queue.append(dialect.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def mode(self, main_and_sub: tuple[float, float]) -> None:
        self.command(dialect.MAV_CMD_DO_SET_MODE, 1.0, *main_and_sub)

    def arm(self) -> None:
        self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for message in self._codec.parse(inbox.received("link")):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
                self.acknowledged.append((message.command, message.result))
        if t_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = t_ns + 1_000_000_000
            self._queue.append(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self.vel_ned_mps is not None:
            self._queue.append(
                dialect.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, 1, VELOCITY_ONLY, 0, 0, 0, *self.vel_ned_mps, 0, 0, 0, 0, 0
                )
            )
        data = b"".join(self._codec.pack(message) for message in self._queue)
        self._queue.clear()
        if data:
            yield Send("link", data)


class Piloted(Flight):
    """A stack with a pilot beside it.

    Attributes:
        pilot: the pilot.
        bytes_sent: number of bytes that the bridge has sent to the autopilot.
    """

    def __init__(self, seed: int = 1) -> None:
        super().__init__(seed)
        self.pilot = Pilot()
        self.bytes_sent = 0
        self.bus.wire(("autopilot", "gcs"), ("pilot", "link"), UDP_DELAY)
        self.bus.add(self.pilot)
        send = self.bus.send

        def counted(owner: str, link: str, data: bytes) -> None:
            self.bytes_sent += len(data) if owner == "vehicle_bridge" else 0
            send(owner, link, data)

        self.bus.send = counted  # type: ignore[method-assign]

    def assert_silence(self, seconds: float) -> None:
        """Assert that the bridge sends one heartbeat a second and nothing else."""
        self.bus.run_for(0.1)
        before = self.bytes_sent
        self.bus.run_for(seconds)
        assert self.bytes_sent - before <= HEARTBEAT_BYTES * (seconds + 1)
        assert (self.status.code, self.status.in_charge) == (Code.EXTERNAL, "external")


@pytest.mark.long
def test_a_pilot_who_changes_the_mode_ends_the_goal_and_has_the_vehicle_until_hover_is_requested() -> None:
    flight = Piloted()
    flight.take_off()
    request = flight.send(topics.GO_TO, go_to(8.0, 0.0, -3.0))
    flight.bus.run_for(2.0)
    flight.pilot.mode(POSITION)
    flight.wait_code(Code.EXTERNAL, 0.5)
    result = flight.finish(request, timeout_s=0.5)
    assert (result.outcome, result.reason) == ("aborted", "taken over: the autopilot was switched to POSCTL")
    flight.assert_silence(8.0)
    assert norm(flight.truth.vel_uav_ned_mps) < 0.5
    assert "hover" in flight.refusal(topics.GO_TO, go_to(0.0, 0.0, -3.0))
    assert flight.request(topics.HOVER, Hover()).hover_mode
    assert (flight.status.code, flight.status.in_charge) == (Code.HOVER, "hover")
    flight.do(topics.GO_TO, go_to(0.0, 0.0, -3.0))
    flight.do(topics.LAND_ON_SPOT, land_at(0.0, 0.0))


def test_a_pilot_who_lands_leaves_a_vehicle_that_takes_off_again() -> None:
    flight = Piloted()
    flight.take_off()
    flight.pilot.mode(LAND)
    flight.wait_code(Code.EXTERNAL, 0.5)
    flight.assert_silence(2.0)
    flight.wait_code(Code.IDLE, 20.0)
    assert not flight.status.armed and flight.status.landed
    assert flight.status.text == "taken over: the autopilot was switched to AUTO.LAND; landed and disarmed"
    flight.take_off()
    assert flight.codes[-3:] == [Code.TAKEOFF, Code.TAKEOFF_DONE, Code.HOVER]


def test_a_program_flies_from_the_ground_and_back_and_the_bridge_stays_silent() -> None:
    flight = Piloted()
    flight.wait_ready()
    pilot = flight.pilot
    pilot.vel_ned_mps = (0.0, 0.0, -1.0)
    flight.bus.run_for(0.5)
    pilot.mode(OFFBOARD)
    pilot.arm()
    flight.wait_code(Code.EXTERNAL, 1.0)
    assert flight.status.text == "taken over: armed, and not by the bridge"
    assert "under other command" in flight.refusal(topics.TAKEOFF, TakeoffGoal())
    flight.assert_silence(4.0)
    assert flight.truth.pos_uav_ned_m[2] < -1.5
    pilot.mode(LAND)
    pilot.vel_ned_mps = None
    flight.wait_code(Code.IDLE, 20.0)
    assert flight.codes == [Code.IDLE, Code.EXTERNAL, Code.IDLE]
    assert all(result == 0 for _, result in pilot.acknowledged)
    flight.take_off()


def test_a_program_that_streams_into_the_bridges_offboard_mode_has_taken_over() -> None:
    flight = Piloted()
    flight.take_off(4.0)
    flight.bus.run_for(1.0)
    flight.pilot.vel_ned_mps = (0.5, 0.0, 0.0)
    flight.pilot.mode(OFFBOARD)
    flight.wait_code(Code.EXTERNAL, 3.0)
    assert "setpoints of somebody else" in flight.status.text
    flight.assert_silence(3.0)
    assert flight.truth.vel_uav_ned_mps[0] > 0.3
    flight.pilot.vel_ned_mps = None
    flight.wait(lambda: flight.status.in_charge == "failsafe", 3.0, "the failsafe after the stream's end")
    assert flight.request(topics.HOVER, Hover()).hover_mode


def test_a_program_that_streams_into_a_goal_has_taken_over() -> None:
    flight = Piloted()
    flight.take_off(4.0)
    request = flight.send(topics.GO_TO, go_to(20.0, 0.0, -4.0, speed_mps=1.0))
    flight.bus.run_for(2.0)
    flight.pilot.vel_ned_mps = (0.0, 0.5, 0.0)
    result = flight.finish(request, timeout_s=4.0)
    assert result.reason == "taken over: the autopilot follows setpoints of somebody else"
    flight.assert_silence(3.0)


def test_a_ground_station_that_only_listens_changes_nothing() -> None:
    flight = Piloted()
    flight.take_off()
    flight.do(topics.GO_TO, go_to(2.0, 1.0, -3.0))
    flight.do(topics.LAND_ON_SPOT, land_at(2.0, 1.0))
    assert Code.EXTERNAL not in flight.codes


def test_a_pilot_may_take_over_from_a_failsafe_and_the_new_bridge_says_so() -> None:
    flight = Piloted()
    flight.take_off(6.0)
    flight.bus.remove("vehicle_bridge")
    flight.bus.run_for(2.0)
    bridge = VehicleBridge(VehicleBridgeConfig(), VehicleConfig(), system_id=1, boot_id=2, secret="s2")
    flight.bus.add(bridge)
    flight.wait(lambda: flight.status.bridge_boot_id == 2 and flight.status.armed, 2.0, "the new bridge")
    assert (flight.status.code, flight.status.in_charge) == (Code.EXTERNAL, "failsafe")
    flight.pilot.mode(HOLD)
    flight.wait(lambda: flight.status.in_charge == "external", 0.5, "the pilot in charge")
    flight.assert_silence(3.0)


@pytest.mark.long
def test_the_stack_without_a_pilot_is_not_taken_over_by_its_own_setpoints() -> None:
    flight = Flight(11)
    flight.wait_ready()
    flight.do(topics.GO_TO, go_to(15.0, -4.0, -8.0, do_takeoff=True, speed_mps=8.0))
    flight.request(topics.HOVER, Hover(hover_pos=(0.0, 0.0, -2.0)))
    flight.bus.run_for(5.0)
    flight.do(topics.LAND_ON_SPOT, land_at(3.0, 0.0))
    assert Code.EXTERNAL not in flight.codes
