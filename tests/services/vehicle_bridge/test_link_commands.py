"""What the bridge sends to the autopilot: commands with their replies, setpoints, and requests for telemetry."""

import pytest

from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink
from jezero.services.vehicle_bridge.vehicle import AutopilotCommand, Target, mode_name
from tests.services.vehicle_bridge.test_link import acknowledged, receive

S, MS = 1_000_000_000, 1_000_000


def sent(data: bytes) -> MavMessage:
    """The one message in bytes for the autopilot."""
    (message,) = MavlinkCodec(1, 1).parse(data)
    return message


def ack(result: int, command: int = dialect.MAV_CMD_COMPONENT_ARM_DISARM) -> MavMessage:
    """Reply to a command of the bridge."""
    return dialect.MAVLink_command_ack_message(command, result, 0, 0, 1, 191)


@pytest.mark.parametrize(
    ("command", "mode"),
    [
        (AutopilotCommand.OFFBOARD, "OFFBOARD"),
        (AutopilotCommand.HOLD, "AUTO.LOITER"),
        (AutopilotCommand.LAND, "AUTO.LAND"),
    ],
)
def test_a_command_for_a_mode_carries_px4s_numbers(command: AutopilotCommand, mode: str) -> None:
    message = sent(AutopilotLink(1).command(command, 0))
    assert (message.target_system, message.target_component) == (1, 1)
    assert message.command == dialect.MAV_CMD_DO_SET_MODE
    assert message.param1 == dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    assert mode_name(int(message.param2) << 16 | int(message.param3) << 24) == mode


@pytest.mark.parametrize(
    ("command", "arm", "force"),
    [
        (AutopilotCommand.ARM, 1.0, 0.0),
        (AutopilotCommand.DISARM, 0.0, 0.0),
        (AutopilotCommand.FORCE_DISARM, 0.0, 21196.0),
    ],
)
def test_only_a_forced_disarming_may_stop_motors_in_the_air(
    command: AutopilotCommand, arm: float, force: float
) -> None:
    """21196 is MAVLink's number that forces it."""
    message = sent(AutopilotLink(1).command(command, 0))
    assert message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM
    assert (message.param1, message.param2) == (arm, force)


def test_each_repetition_of_a_command_is_counted_in_it() -> None:
    link = AutopilotLink(1)
    counts = [sent(link.command(AutopilotCommand.ARM, t_s * S)).confirmation for t_s in range(258)]
    assert counts == [*range(256), 255, 255], "the count has a byte"
    assert sent(link.command(AutopilotCommand.DISARM, 258 * S)).confirmation == 0


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (dialect.MAV_RESULT_TEMPORARILY_REJECTED, "arming temporarily rejected"),
        (dialect.MAV_RESULT_DENIED, "arming denied"),
        (dialect.MAV_RESULT_UNSUPPORTED, "arming unsupported"),
        (dialect.MAV_RESULT_FAILED, "arming failed"),
        (9, "arming refused with result 9"),
        (dialect.MAV_RESULT_ACCEPTED, ""),
        (dialect.MAV_RESULT_IN_PROGRESS, ""),
    ],
)
def test_a_refusal_is_named_and_holds_until_the_command_is_accepted(result: int, words: str) -> None:
    link, accepted = AutopilotLink(1), words == ""
    assert link.command_failure(0) == ""
    link.command(AutopilotCommand.ARM, 0)
    receive(link, ack(result))
    assert link.command_failure(0) == words
    assert (acknowledged(link) is AutopilotCommand.ARM) is accepted
    again_after_ms = [t for t in range(0, 2100, 100) if link.command(AutopilotCommand.ARM, t * MS)]
    assert again_after_ms == ([1500, 2000] if accepted else [500, 1000, 1500, 2000])
    receive(link, ack(dialect.MAV_RESULT_ACCEPTED), at_ns=2 * S)
    assert link.command_failure(2 * S) == ""
    assert acknowledged(link) is AutopilotCommand.ARM


def test_another_command_begins_without_the_refusal_of_the_one_before() -> None:
    link = AutopilotLink(1)
    link.command(AutopilotCommand.ARM, 0)
    receive(link, ack(dialect.MAV_RESULT_DENIED))
    assert link.command(AutopilotCommand.OFFBOARD, S // 10), "at once"
    assert link.command_failure(S // 10) == ""
    receive(link, ack(dialect.MAV_RESULT_FAILED, dialect.MAV_CMD_DO_SET_MODE))
    assert link.command_failure(S // 10) == "offboard mode failed"
    assert link.command(None, S) == b""
    assert link.command_failure(S) == ""


def test_an_acknowledgement_without_a_command_is_none() -> None:
    link = AutopilotLink(1)
    receive(link, ack(dialect.MAV_RESULT_ACCEPTED))
    assert acknowledged(link) is None
    link.command(AutopilotCommand.ARM, 0)
    link.command(None, 0)
    receive(link, ack(dialect.MAV_RESULT_ACCEPTED))
    assert acknowledged(link) is None


@pytest.mark.parametrize(("severity", "is_warning"), [(0, True), (3, True), (4, True), (5, False), (6, False)])
def test_a_text_is_a_warning_by_its_severity(severity: int, is_warning: bool) -> None:
    link = AutopilotLink(1)
    receive(link, dialect.MAVLink_statustext_message(severity, b"Compass inconsistent"))
    assert link.warning(S) == ("Compass inconsistent" if is_warning else "")


@pytest.mark.parametrize(("age_s", "counts"), [(4, True), (8, False)])
def test_a_warning_explains_a_failure_for_some_seconds_also_without_a_refusal(age_s: int, counts: bool) -> None:
    link = AutopilotLink(1)
    receive(link, dialect.MAVLink_statustext_message(3, b"Compass inconsistent"), at_ns=10 * S)
    text = "Compass inconsistent" if counts else ""
    assert link.warning((10 + age_s) * S) == text
    assert link.command_failure((10 + age_s) * S) == text


POSITION_BITS, VELOCITY_BITS, ACCELERATION_BITS, YAW_RATE_BIT = 0b111, 0b111 << 3, 0b111 << 6, 1 << 11
"""Bits of MAVLink's POSITION_TARGET_TYPEMASK: what the autopilot ignores."""


@pytest.mark.parametrize(
    ("target", "ignored"),
    [
        (Target((1.0, 2.0, -3.0), None, None, 0.5), VELOCITY_BITS | ACCELERATION_BITS | YAW_RATE_BIT),
        (Target(None, (0.5, -0.5, 0.25), None, 0.5), POSITION_BITS | ACCELERATION_BITS | YAW_RATE_BIT),
        (Target((1.0, 2.0, -3.0), (0.5, -0.5, 0.25), (0.125, 1.0, -1.0), 0.5, 0.25), 0),
        (Target((1.0, 2.0, -3.0), None, None, 0.5, 0.0), VELOCITY_BITS | ACCELERATION_BITS),
    ],
)
def test_a_setpoint_carries_what_the_target_has_and_masks_the_rest(target: Target, ignored: int) -> None:
    message, nothing = sent(AutopilotLink(1).setpoint(target, 5 * S)), (0.0, 0.0, 0.0)
    assert message.type_mask == ignored
    assert message.coordinate_frame == dialect.MAV_FRAME_LOCAL_NED
    assert (message.target_system, message.target_component, message.time_boot_ms) == (1, 1, 5000)
    assert (message.x, message.y, message.z) == (target.pos_ned_m or nothing)
    assert (message.vx, message.vy, message.vz) == (target.vel_ned_mps or nothing)
    assert (message.afx, message.afy, message.afz) == (target.acc_ned_mps2 or nothing)
    assert (message.yaw, message.yaw_rate) == (0.5, target.yaw_rate_rps or 0.0)


def test_a_setpoint_can_be_sent_also_after_fifty_days() -> None:
    """Its time has 32 bits of milliseconds."""
    target = Target((1.0, 2.0, -3.0), None, None, 0.0)
    assert sent(AutopilotLink(1).setpoint(target, (2**32 + 7) * MS)).time_boot_ms == 7


def test_a_heartbeat_is_requested_when_the_last_one_is_old() -> None:
    link, heartbeat = AutopilotLink(1), dialect.MAVLink_heartbeat_message(2, 12, 1, 6 << 16, 4, 3)
    receive(link, heartbeat, at_ns=S)
    assert [t for t in range(0, 500, 20) if link.request_heartbeat(S + t * MS)] == [160, 320, 480]
    receive(link, heartbeat, at_ns=S + 490 * MS)
    assert not link.request_heartbeat(S + 600 * MS)
    request = sent(link.request_heartbeat(S + 700 * MS))
    assert (request.command, request.param1) == (dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_HEARTBEAT)


def test_the_batterys_critical_level_is_requested_by_its_name() -> None:
    """The index must be -1: an autopilot that gets another index replies with the parameter of that index."""
    request = sent(AutopilotLink(1).request_battery_critical(S))
    assert (request.target_system, request.target_component) == (1, 1)
    assert (request.param_id, request.param_index) == ("BAT_CRIT_THR", -1)


def test_the_time_is_requested_with_a_stamp_and_only_a_reply_has_the_autopilots() -> None:
    link = AutopilotLink(1)
    request = sent(link.request_time(123_456))
    assert (request.tc1, request.ts1) == (0, 123_456)
    messages = [dialect.MAVLink_timesync_message(tc1, 123_456) for tc1 in (0, 777)]
    assert receive(link, *messages).time_replies == [(777, 123_456)]


def test_the_bridge_introduces_itself_as_an_active_computer_without_an_autopilot() -> None:
    message = sent(AutopilotLink(1).heartbeat())
    assert (message.type, message.autopilot) == (dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID)
    assert (message.base_mode, message.system_status) == (0, dialect.MAV_STATE_ACTIVE)


def test_a_narrow_line_carries_position_and_attitude_at_30_hz_instead_of_odometry() -> None:
    link = AutopilotLink(1, on_hardware=True)
    assert link.rate is not None

    def requested_us() -> dict[int, float]:
        return {int(m.param1): m.param2 for m in MavlinkCodec(1, 1).parse(link.request_intervals())}

    wide = requested_us()
    assert 1e6 / wide[dialect.MAVLINK_MSG_ID_ODOMETRY] == pytest.approx(50.0)
    assert dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED not in wide
    link.rate.narrow = True
    narrow = requested_us()
    assert narrow[dialect.MAVLINK_MSG_ID_ODOMETRY] == -1.0, "MAVLink's number for never"
    for kind in (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION):
        assert 1e6 / narrow[kind] == pytest.approx(30.0, abs=1.0)
    both = (wide.keys() & narrow.keys()) - {dialect.MAVLINK_MSG_ID_ODOMETRY}
    assert len(both) == len(wide) - 1
    assert all(narrow[kind] >= 2.0 * wide[kind] for kind in both), "all else comes half as often at most"
