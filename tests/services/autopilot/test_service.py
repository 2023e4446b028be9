"""The autopilot at its links: one answer per HIL_SENSOR, acknowledged commands, and nothing from garbage."""

from collections.abc import Sequence
from random import Random
from typing import Any

import pytest

from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Send
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.service import HIL, OFFBOARD, Autopilot

G = 9.81
ARM, MODE = dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE
INTERVAL, REQUEST = dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAV_CMD_REQUEST_MESSAGE
NAN = float("nan")


class Box:
    """The autopilot's inbox with all links up."""

    wall_ns = stalled_ns = 0
    connected = True
    has_requests = False
    departed: Sequence[str] = ()
    responses: Sequence[Any] = ()
    sent: Sequence[Any] = ()

    def __init__(self) -> None:
        self.bytes: dict[str, bytes] = {}
        self.hil_connections = 1

    def new(self, topic: Any) -> Sequence[Any]:
        return ()

    def latest(self, topic: Any) -> None:
        return None

    def requests(self, endpoint: Any) -> Sequence[Any]:
        return ()

    def received(self, link: str) -> bytes:
        return self.bytes.get(link, b"")

    def connections(self, link: str) -> int:
        return self.hil_connections if link == HIL else 1

    def is_up(self, link: str) -> bool:
        return True


class Bench:
    """An autopilot on a table: sensors at rest, their last digits alive, on one link, a companion on the other."""

    def __init__(self, config: AutopilotConfig | None = None) -> None:
        self.autopilot = Autopilot(config or AutopilotConfig(), VehicleConfig(), system_id=1)
        self.box = Box()
        self.simulator = MavlinkCodec(1, 25)
        self.companion = MavlinkCodec(1, 191)
        self.codecs = {HIL: MavlinkCodec(255, 1), OFFBOARD: MavlinkCodec(255, 1)}
        self.t_us = 0
        self.health: list[Health] = []
        self.digits = {"slow": True, "gps": True}
        self.gps_late_us = 0

    def step(self, hil: bytes = b"", offboard: bytes = b"") -> dict[str, list[MavMessage]]:
        """Deliver bytes; returns the messages that came back by link."""
        self.box.bytes = {HIL: hil, OFFBOARD: offboard}
        out: dict[str, list[MavMessage]] = {HIL: [], OFFBOARD: []}
        for output in self.autopilot.step(0, self.box):
            if isinstance(output, Send) and output.link in out:
                out[output.link] += self.codecs[output.link].parse(output.data)
            elif isinstance(output, Health):
                self.health.append(output)
        return out

    def sensor(self, acc: tuple[float, float, float] = (0.0, 0.0, -G), gyro_x: float = 0.0) -> bytes:
        self.t_us += 4000
        slow, digit = self.t_us % 20_000 == 0, 1e-4 * (self.digits["slow"] and self.t_us % 40_000 == 0)
        mag, up_m = (0.216 + digit, 0.0, 0.43), 488.0 + digit
        return self.simulator.pack(
            dialect.MAVLink_hil_sensor_message(
                self.t_us, *acc, gyro_x, 0.0, 0.0, *mag, 955.0, 0.0, up_m, 20.0, 0x1BFF if slow else 0x3F
            )
        )

    def gps(self, satellites: int = 12, north_m: float = 0.0) -> bytes:
        digit, lat = self.digits["gps"] and self.t_us // 100_000 % 2, 473977418 + round(north_m * 89.93)
        return self.simulator.pack(
            dialect.MAVLink_hil_gps_message(
                max(0, self.t_us - self.gps_late_us), 3, lat, 85455938, 488000, 50, 80, 0, digit, 0, 0, 0, satellites
            )
        )

    def rest(self, seconds: float, offboard: bytes = b"", north_m: float = 0.0) -> list[MavMessage]:
        """Stand still with all sensors; returns what the companion received."""
        received = []
        for number in range(round(seconds * 250)):
            gps = self.gps(north_m=north_m) if number % 25 == 0 else b""
            received += self.step(self.sensor() + gps, offboard if number % 10 == 0 else b"")[OFFBOARD]
        return received

    def command(self, command: int, *parameters: float) -> tuple[int, list[MavMessage]]:
        """Result of the acknowledgement, and everything received until it came."""
        data = self.companion.pack(
            dialect.MAVLink_command_long_message(1, 1, command, 0, *(*parameters, *[0.0] * 7)[:7])
        )
        received = self.step(b"", data)[OFFBOARD]
        acks = [m for m in received if m.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK]
        assert len(acks) == 1
        assert (acks[0].command, acks[0].target_component) == (command, 191)
        return acks[0].result, received

    def setpoint(self, mask: int = 0b1101_1100_0111, velocity: float = 0.0, frame: int = 1) -> bytes:
        return self.companion.pack(
            dialect.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, frame, mask, 0.0, 0.0, 0.0, velocity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )

    def texts(self, received: list[MavMessage]) -> str:
        return " ".join(m.text for m in received if m.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def kinds(received: list[MavMessage], kind: int) -> list[MavMessage]:
    return [m for m in received if m.get_msgId() == kind]


def test_each_hil_sensor_gets_one_answer_with_its_time(bench: Bench) -> None:
    for _ in range(5):
        answers = bench.step(bench.sensor())[HIL]
        assert [(m.get_msgId(), m.time_usec) for m in answers] == [
            (dialect.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS, bench.t_us)
        ]
        assert tuple(answers[0].controls[:4]) == (0.0, 0.0, 0.0, 0.0)
        assert not answers[0].mode & 128
    assert len(bench.step(bench.sensor() + bench.sensor())[HIL]) == 2


@pytest.mark.parametrize(("sensor", "word"), [("gps", "settling"), ("slow", "no magnetometer")])
def test_a_sensor_that_repeats_itself_to_the_last_digit_counts_as_none(bench: Bench, sensor: str, word: str) -> None:
    bench.rest(5.0)
    assert bench.command(ARM, 1.0)[0] == dialect.MAV_RESULT_ACCEPTED
    bench.command(ARM, 0.0)
    bench.digits[sensor] = False
    bench.rest(6.0)
    result, received = bench.command(ARM, 1.0)
    assert result != dialect.MAV_RESULT_ACCEPTED
    assert word in bench.texts(received)


@pytest.mark.parametrize(("late_us", "armed"), [(1_400_000, True), (1_600_000, False), (-10_000_000, False)])
def test_a_fix_of_another_time_counts_as_none(bench: Bench, late_us: int, armed: bool) -> None:
    bench.rest(5.0)
    bench.gps_late_us = late_us
    bench.rest(6.0)
    result, received = bench.command(ARM, 1.0)
    assert (result == dialect.MAV_RESULT_ACCEPTED) == armed
    assert armed or "settling" in bench.texts(received)


def test_telemetry_has_px4s_rates_and_the_truth_at_rest(bench: Bench) -> None:
    bench.rest(5.0)
    received = bench.rest(2.0)
    odometry = kinds(received, dialect.MAVLINK_MSG_ID_ODOMETRY)
    assert 98 <= len(odometry) <= 102
    assert 1 <= len(kinds(received, dialect.MAVLINK_MSG_ID_HEARTBEAT)) <= 3
    assert max(abs(v) for v in (odometry[-1].x, odometry[-1].y, odometry[-1].z, odometry[-1].vx)) < 0.2
    assert kinds(received, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)[-1].landed_state == 1
    assert kinds(received, dialect.MAVLINK_MSG_ID_SYS_STATUS)[-1].onboard_control_sensors_health & 1 << 28


def test_the_origin_is_sent_once_and_on_request_as_px4_does(bench: Bench) -> None:
    origin = dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
    assert bench.command(REQUEST, origin)[0] == dialect.MAV_RESULT_DENIED
    (sent,) = kinds(bench.rest(7.0), origin)
    assert (sent.latitude, sent.longitude) == (473977418, 85455938)
    assert bench.command(INTERVAL, origin, 100_000.0)[0] == dialect.MAV_RESULT_ACCEPTED
    assert kinds(bench.rest(1.0), origin) == []
    result, received = bench.command(REQUEST, origin)
    assert result == dialect.MAV_RESULT_ACCEPTED
    assert [m.latitude for m in kinds(received, origin)] == [473977418]


def test_a_stream_has_the_rate_it_is_asked_for(bench: Bench) -> None:
    bench.rest(5.0)
    assert bench.command(INTERVAL, 331, 100_000.0)[0] == dialect.MAV_RESULT_ACCEPTED
    assert 19 <= len(kinds(bench.rest(2.0), dialect.MAVLINK_MSG_ID_ODOMETRY)) <= 21
    assert bench.command(INTERVAL, 331, -1.0)[0] == dialect.MAV_RESULT_ACCEPTED
    assert kinds(bench.rest(1.0), dialect.MAVLINK_MSG_ID_ODOMETRY) == []
    assert bench.command(INTERVAL, 9999, 1000.0)[0] == dialect.MAV_RESULT_UNSUPPORTED
    _, received = bench.command(REQUEST, 331)
    assert len(kinds(received, dialect.MAVLINK_MSG_ID_ODOMETRY)) == 1


def test_without_gnss_it_refuses_to_arm_and_says_why_in_words(bench: Bench) -> None:
    for _ in range(1000):
        bench.step(bench.sensor())
    result, received = bench.command(ARM, 1.0)
    assert result == dialect.MAV_RESULT_TEMPORARILY_REJECTED
    assert "Arming denied: no GNSS fix yet" in bench.texts(received + bench.step(bench.sensor())[OFFBOARD])


def test_gnss_that_is_lost_forbids_arming(bench: Bench) -> None:
    bench.rest(5.0)
    for _ in range(400):
        bench.step(bench.sensor())
    _, received = bench.command(ARM, 1.0)
    assert "no GNSS data for 1.7 s" in bench.texts(received + bench.step(bench.sensor())[OFFBOARD])


def test_offboard_needs_a_stream_and_then_arms_and_idles(bench: Bench) -> None:
    bench.rest(5.0)
    assert bench.command(MODE, 1.0, 6.0)[0] == dialect.MAV_RESULT_TEMPORARILY_REJECTED
    stream = bench.setpoint()
    bench.rest(0.5, stream)
    assert bench.command(MODE, 1.0, 6.0)[0] == dialect.MAV_RESULT_ACCEPTED
    assert bench.command(ARM, 1.0)[0] == dialect.MAV_RESULT_ACCEPTED
    received = bench.rest(1.0, stream)
    heartbeat = kinds(received, dialect.MAVLINK_MSG_ID_HEARTBEAT)[-1]
    assert heartbeat.base_mode & 128 and heartbeat.custom_mode == 6 << 16
    answer = bench.step(bench.sensor())[HIL][0]
    assert answer.mode & 128
    assert tuple(answer.controls[:4]) == pytest.approx((0.05,) * 4)


@pytest.mark.parametrize(
    ("command", "parameters", "result"),
    [
        (ARM, (2.0,), dialect.MAV_RESULT_DENIED),
        (ARM, (NAN,), dialect.MAV_RESULT_DENIED),
        (MODE, (1.0, 77.0), dialect.MAV_RESULT_DENIED),
        (MODE, (NAN, 6.0), dialect.MAV_RESULT_DENIED),
        (MODE, (0.0, 6.0), dialect.MAV_RESULT_DENIED),
        (dialect.MAV_CMD_REQUEST_MESSAGE, (NAN,), dialect.MAV_RESULT_UNSUPPORTED),
        (MODE, (1.0, 6.0, NAN), dialect.MAV_RESULT_TEMPORARILY_REJECTED),
        (12345, (), dialect.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_commands_that_make_no_sense_are_refused(
    bench: Bench, command: int, parameters: tuple[float, ...], result: int
) -> None:
    bench.rest(5.0)
    assert bench.command(command, *parameters)[0] == result


@pytest.mark.parametrize(
    "bad", [{"velocity": NAN}, {"velocity": float("inf")}, {"mask": 0xFFFF}, {"frame": 6}, {"frame": 8, "mask": 0}]
)
def test_a_setpoint_that_makes_no_sense_is_no_stream(bench: Bench, bad: dict[str, Any]) -> None:
    bench.rest(5.0)
    bench.rest(0.5, bench.setpoint(**bad))
    assert bench.command(MODE, 1.0, 6.0)[0] == dialect.MAV_RESULT_TEMPORARILY_REJECTED


def test_garbage_on_any_link_changes_nothing(bench: Bench) -> None:
    bench.rest(5.0)
    random = Random(1)
    for _ in range(200):
        garbage = random.randbytes(200)
        answers = bench.step(garbage, garbage)
        assert kinds(answers[OFFBOARD], dialect.MAVLINK_MSG_ID_COMMAND_ACK) == []
    odometry = kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY)[-1]
    assert max(abs(odometry.x), abs(odometry.z), abs(odometry.vx)) < 0.3


def test_readings_that_are_not_finite_are_not_used(bench: Bench) -> None:
    bench.rest(5.0)
    for _ in range(100):
        bench.step(bench.sensor(acc=(NAN, 0.0, -G), gyro_x=float("inf")))
    odometry = kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY)[-1]
    assert max(abs(odometry.x), abs(odometry.z), abs(odometry.vx)) < 0.3


@pytest.mark.parametrize("acc_x", [1e30, 1e5, -2e3])
def test_readings_that_no_sensor_gives_are_not_used_and_counted(bench: Bench, acc_x: float) -> None:
    bench.rest(5.0)
    bench.step(bench.sensor(acc=(acc_x, 0.0, -G)))
    odometry = kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY)[-1]
    assert max(abs(odometry.x), abs(odometry.z), abs(odometry.vx)) < 0.3
    assert bench.health[-1].text == "connected to the simulator; 1 malformed messages"


def test_home_is_where_the_estimate_started_and_then_where_it_armed(bench: Bench) -> None:
    bench.rest(5.0)
    assert kinds(bench.rest(1.2), dialect.MAVLINK_MSG_ID_HOME_POSITION)[-1].latitude == 473977418
    bench.rest(3.0, north_m=1.0)
    result, received = bench.command(ARM, 1.0)
    assert result == dialect.MAV_RESULT_ACCEPTED
    home = kinds(received, dialect.MAVLINK_MSG_ID_HOME_POSITION)[-1]
    assert 0.3 < home.x < 1.1
    assert home.latitude - 473977418 == pytest.approx(home.x * 89.9, abs=2.0)


def test_a_point_to_hold_moves_with_a_reset_of_the_position_before_anyone_can_answer_it(bench: Bench) -> None:
    bench.rest(5.0)
    step = bench.rest(3.5, north_m=3.0)
    counters = [m.reset_counter for m in kinds(step, dialect.MAVLINK_MSG_ID_ODOMETRY)]
    assert (counters[0], counters[-1]) == (0, 1)
    home = kinds(bench.rest(1.1, north_m=3.0), dialect.MAVLINK_MSG_ID_HOME_POSITION)[-1]
    assert home.x == pytest.approx(3.0, abs=0.1)


def test_integer_commands_do_the_same(bench: Bench) -> None:
    bench.rest(5.0)
    data = bench.companion.pack(dialect.MAVLink_command_int_message(1, 1, 0, ARM, 0, 0, 1.0, 0, 0, 0, 0, 0, 0))
    received = bench.step(b"", data)[OFFBOARD]
    acks = kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK)
    assert [(m.command, m.result) for m in acks] == [(ARM, dialect.MAV_RESULT_ACCEPTED)]
    assert kinds(received, dialect.MAVLINK_MSG_ID_HEARTBEAT)[-1].base_mode & 128


def test_landing_needs_no_parameters(bench: Bench) -> None:
    bench.rest(5.0)
    assert bench.command(dialect.MAV_CMD_NAV_LAND, *[NAN] * 7)[0] == dialect.MAV_RESULT_ACCEPTED


def test_a_new_simulator_or_time_that_goes_back_or_leaps_makes_it_start_over(bench: Bench) -> None:
    bench.rest(5.0)
    bench.t_us = 0
    assert kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY) == []
    bench.rest(5.0)
    bench.box.hil_connections += 1
    assert kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY) == []
    bench.rest(5.0)
    bench.t_us += 2_000_000
    assert kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY) == []


def test_commands_for_another_system_are_not_even_answered(bench: Bench) -> None:
    bench.rest(5.0)
    foreign = bench.companion.pack(dialect.MAVLink_command_long_message(2, 1, ARM, 0, 1.0, 0, 0, 0, 0, 0, 0))
    assert kinds(bench.step(b"", foreign)[OFFBOARD], dialect.MAVLINK_MSG_ID_COMMAND_ACK) == []


def test_the_range_of_the_simulators_rangefinder_is_passed_on_when_it_is_requested(bench: Bench) -> None:
    kind = dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR
    bench.step(bench.sensor())
    assert bench.command(INTERVAL, kind, 40_000.0)[0] == dialect.MAV_RESULT_ACCEPTED
    for t_ms, range_cm, orientation in ((70, 230, 25), (71, 990, 0)):
        sent = dialect.MAVLink_distance_sensor_message(t_ms, 15, 1000, range_cm, 0, 0, orientation, 255)
        bench.step(bench.simulator.pack(sent))
    passed = kinds([message for _ in range(20) for message in bench.step(bench.sensor())[OFFBOARD]], kind)
    numbers = {(m.time_boot_ms, m.min_distance, m.max_distance, m.current_distance) for m in passed}
    assert numbers == {(70, 15, 1000, 230)}
