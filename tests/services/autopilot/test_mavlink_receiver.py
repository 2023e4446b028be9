"""Parameters, refusals, ping and time at the autopilot's links, and who may stop the motors in the air."""

import msgspec
import pytest

from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import BatteryConfig
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.mavlink_receiver import ForcedDisarmRule, decode_parameter, encode_parameter
from jezero.services.autopilot.parameters import ROWS, Parameters, Row, Value
from jezero.services.autopilot.service import OFFBOARD
from tests.services.autopilot.test_service import Bench, kinds

REQUEST_MESSAGE = dialect.MAV_CMD_REQUEST_MESSAGE


def send(bench: Bench, message: MavMessage) -> list[MavMessage]:
    return bench.step(b"", bench.companion.pack(message))[OFFBOARD]


def set_parameter(bench: Bench, name: str, value: Value) -> Value | None:
    """Set a parameter; returns the value of the reply."""
    raw, kind = encode_parameter(value)
    received = send(bench, dialect.MAVLink_param_set_message(1, 1, name.encode(), raw, kind))
    reply = kinds(received, dialect.MAVLINK_MSG_ID_PARAM_VALUE)
    return decode_parameter(reply[0].param_value, reply[0].param_type) if reply else None


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_everything_that_may_be_set_is_a_valid_setting(row: Row) -> None:
    for value in row.choices or (row.kind(row.low), row.kind(row.high)):
        parameters = Parameters(AutopilotConfig(), BatteryConfig(), 1)
        assert parameters.set(row.name, value)
        assert parameters.get(row.name) == pytest.approx(value)
        msgspec.convert(msgspec.to_builtins(parameters.config), AutopilotConfig)
        msgspec.convert(msgspec.to_builtins(parameters.battery), BatteryConfig)


@pytest.mark.parametrize(
    ("name", "value", "reply"),
    [
        ("MIS_TAKEOFF_ALT", 4.0, 4.0),
        ("MIS_TAKEOFF_ALT", -1.0, 2.5),
        ("MIS_TAKEOFF_ALT", float("nan"), 2.5),
        ("MIS_TAKEOFF_ALT", 4, 2.5),
        ("COM_DL_LOSS_T", 20, 20),
        ("COM_DL_LOSS_T", 20.0, 10),
        ("COM_DL_LOSS_T", -5, 10),
        ("COM_LOW_BAT_ACT", 3, 3),
        ("COM_LOW_BAT_ACT", 1, 0),
        ("MAV_SYS_ID", 9, 1),
        ("NO_SUCH_THING", 1.0, None),
    ],
)
def test_a_parameter_is_set_or_the_old_value_returned(name: str, value: Value, reply: Value | None) -> None:
    bench = Bench()
    bench.rest(0.1)
    assert set_parameter(bench, name, value) == reply


def test_the_whole_list_comes_in_order_and_each_can_be_read_by_name_and_index() -> None:
    bench = Bench()
    bench.rest(0.1)
    values = kinds(send(bench, dialect.MAVLink_param_request_list_message(1, 1)), dialect.MAVLINK_MSG_ID_PARAM_VALUE)
    assert [m.param_index for m in values] == list(range(values[0].param_count))
    assert len({m.param_id for m in values}) == len(values) > 50
    by_index = send(bench, dialect.MAVLink_param_request_read_message(1, 1, b"", 3))
    by_name = send(bench, dialect.MAVLink_param_request_read_message(1, 1, values[3].param_id.encode(), -1))
    reply = [kinds(received, dialect.MAVLINK_MSG_ID_PARAM_VALUE)[0] for received in (by_index, by_name)]
    assert [m.param_id for m in reply] == [values[3].param_id] * 2
    assert send(bench, dialect.MAVLink_param_request_read_message(1, 1, b"", 9999)) == []


def test_files_and_missions_are_politely_refused() -> None:
    bench = Bench()
    bench.rest(0.1)
    request = [7, 0, 2, 4, *[0] * 247]  # sequence 7, session 2, open
    (nak,) = send(bench, dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, request))
    assert (nak.target_component, nak.payload[:6], nak.payload[12]) == (191, [8, 0, 2, 129, 1, 4], 7)
    (count,) = send(bench, dialect.MAVLink_mission_request_list_message(1, 1))
    assert count.count == 0
    (acknowledged,) = send(bench, dialect.MAVLink_mission_count_message(1, 1, 3))
    assert acknowledged.type == dialect.MAV_MISSION_UNSUPPORTED


def test_pings_and_time_are_answered() -> None:
    bench = Bench()
    bench.rest(0.1)
    (ping,) = send(bench, dialect.MAVLink_ping_message(5, 9, 0, 0))
    assert (ping.seq, ping.target_component) == (9, 191)
    (sync,) = send(bench, dialect.MAVLink_timesync_message(0, 77))
    assert (sync.tc1, sync.ts1) == (bench.t_us * 1000, 77)


@pytest.mark.parametrize(("system", "taken"), [(1, True), (245, True), (255, True), (77, False), (2, False)])
def test_commands_are_taken_of_the_listed_systems_alone_and_health_names_the_others(system: int, taken: bool) -> None:
    bench = Bench()
    bench.rest(0.1)
    bench.companion = MavlinkCodec(system, 190)
    heartbeat = bench.companion.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.step(b"", heartbeat)
    received = send(bench, dialect.MAVLink_command_long_message(1, 1, REQUEST_MESSAGE, 0, 148.0, *[0.0] * 6))
    bench.step(bench.sensor())
    assert bool(kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK)) == taken
    refusal = f"1 messages of MAVLink system {system} refused: see ground_systems in autopilot.toml"
    assert (refusal in bench.health[-1].text) == (not taken)


def test_the_list_of_ground_stations_is_a_setting() -> None:
    bench = Bench(msgspec.convert({"telemetry": {"ground_systems": [7]}}, AutopilotConfig))
    bench.rest(0.1)
    for system, taken in ((7, True), (255, False)):
        bench.companion = MavlinkCodec(system, 190)
        received = send(bench, dialect.MAVLink_command_long_message(1, 1, REQUEST_MESSAGE, 0, 148.0, *[0.0] * 6))
        assert bool(kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK)) == taken


# -- the rule of the forced disarm in the air, alone -----------------------------------------------------


@pytest.mark.parametrize(
    ("listed", "on_ground", "system", "refusal"),
    [
        ((), (255,), 255, ""),
        ((), (255,), 252, "MAVLink system 252 sent nothing before the takeoff"),
        ((), (), 1, "MAVLink system 1 sent nothing before the takeoff"),
        ((245,), (255,), 245, ""),
        ((245,), (255,), 255, "MAVLink system 255 is not in force_disarm_systems"),
    ],
)
def test_listed_systems_may_and_without_a_list_those_that_were_there_before_the_takeoff(
    listed: tuple[int, ...], on_ground: tuple[int, ...], system: int, refusal: str
) -> None:
    rule = ForcedDisarmRule(listed)
    for each in on_ground:
        rule.on_message_on_ground(each)
    assert rule.refusal(system) == refusal


def test_a_flood_of_denied_commands_is_one_line_in_the_log_of_a_flight(capfd: pytest.CaptureFixture[str]) -> None:
    rule = ForcedDisarmRule(())
    for _ in range(3):
        rule.log("by system 252")
    rule.on_message_on_ground(255)
    rule.log("by system 252")
    assert capfd.readouterr().err == "by system 252\n" * 2
