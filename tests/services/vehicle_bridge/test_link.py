"""Translation from and to MAVLink."""

from math import nan
from typing import Any

import pytest

from jezero.base.frames import quat_from_euler
from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.schemas.commands import Phase
from jezero.services.vehicle_bridge.autopilot_link import INTERVALS_US, AutopilotLink, TelemetryBatch
from jezero.services.vehicle_bridge.parameters import encoded
from jezero.services.vehicle_bridge.vehicle import AutopilotCommand, mode_name
from tests.services.vehicle_bridge.rig import Rig

S = 1_000_000_000
NO_COVARIANCE = [nan] * 21


def odometry(t_us: int = 1_000_000, *, child_frame: int = 1, yaw_rad: float = 0.0, **fields: Any) -> MavMessage:
    given: dict[str, Any] = {"x": 1.0, "y": 2.0, "z": -3.0, "vx": 1.0, "vy": 0.0, "vz": 0.0, "frame_id": 1}
    given |= {"rollspeed": 0.1, "pitchspeed": 0.2, "yawspeed": 0.3, **fields}
    return dialect.MAVLink_odometry_message(
        time_usec=t_us,
        child_frame_id=child_frame,
        q=list(quat_from_euler(0.0, 0.0, yaw_rad)),
        pose_covariance=[0.04, 0, 0, 0, 0, 0, 0.09, *[0.0] * 14],
        velocity_covariance=NO_COVARIANCE,
        reset_counter=0,
        estimator_type=8,
        quality=100,
        **given,
    )


def receive(
    link: AutopilotLink, *messages: MavMessage, codec: MavlinkCodec | None = None, at_ns: int = 0
) -> TelemetryBatch:
    codec = codec or MavlinkCodec(1, 1)
    return link.receive(b"".join(codec.pack(m) for m in messages), at_ns, at_ns, epoch_id=4)


def acknowledged(link: AutopilotLink) -> AutopilotCommand | None:
    """The acknowledged command; a function, as mypy takes an attribute for unchanged between two asserts."""
    return link.acknowledged


def test_odometry_is_vehicle_time_and_world_ned() -> None:
    link = AutopilotLink(1)
    receive(link, odometry())
    received = link.telemetry.odometry
    assert received is not None
    assert received.t_ns == S
    assert received.epoch_id == 4
    assert received.pos_uav_ned_m == (1.0, 2.0, -3.0)
    assert received.vel_uav_ned_mps == pytest.approx((1.0, 0.0, 0.0))
    assert received.std_pos_m == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("q", "rate_rps"),
    [
        ((0.0, 0.0, 0.0, 0.0), 0.0),
        ((1e-20, 0.0, 0.0, 0.0), 0.0),
        ((1.0, 1e38, 0.0, 0.0), 0.0),
        ((nan, 0.0, 0.0, 0.0), 0.0),
        ((1.0, 0.0, 0.0, 0.0), nan),
        ((1.0, 0.0, 0.0, 0.0), 1e30),
    ],
)
def test_an_impossible_attitude_on_a_narrow_line_is_counted_and_dropped(
    q: tuple[float, float, float, float], rate_rps: float
) -> None:
    link = AutopilotLink(1, on_hardware=True)
    assert link.rate is not None
    link.rate.narrow = True
    position = dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0)
    receive(link, dialect.MAVLink_attitude_quaternion_message(1000, *q, rate_rps, 0.0, 0.0), position)
    assert link.malformed == 1
    assert link.telemetry.odometry is None
    receive(link, dialect.MAVLink_attitude_quaternion_message(1000, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), position)
    assert link.telemetry.odometry is not None


def test_the_echo_of_a_setpoint_has_the_time_since_the_autopilots_boot_and_nan_in_each_axis_that_is_masked() -> None:
    fields = (1.0, 2.0, -3.0, 0.5, 0.25, -0.125, 0.0, 0.0, 0.0, 0.0, 0.0)
    for mask, expected in ((0b000111, (nan, nan, nan, 0.5, 0.25, -0.125)), (0b111000, (1.0, 2.0, -3.0, nan, nan, nan))):
        message = dialect.MAVLink_position_target_local_ned_message(1500, 1, mask, *fields)
        echo = receive(AutopilotLink(1), message).setpoint_echo
        assert echo is not None
        assert echo.t_ns == 1_500_000_000
        assert (*echo.pos_ned_m, *echo.vel_ned_mps) == pytest.approx(expected, nan_ok=True)


def test_velocity_in_the_body_frame_is_turned_into_ned() -> None:
    link = AutopilotLink(1)
    receive(link, odometry(child_frame=dialect.MAV_FRAME_BODY_FRD, yaw_rad=1.5707963))
    received = link.telemetry.odometry
    assert received is not None
    assert received.vel_uav_ned_mps == pytest.approx((0.0, 1.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(
    "fields",
    [
        {"x": nan},
        {"vz": float("inf")},
        *({axis: 2e6} for axis in "xyz"),
        *({f"v{axis}": 2e3} for axis in "xyz"),
        *({f"{turn}speed": 2e3} for turn in ("roll", "pitch", "yaw")),
        {"frame_id": 12},
    ],
)
def test_odometry_that_cannot_be_is_counted_and_not_believed(fields: dict[str, Any]) -> None:
    link = AutopilotLink(1)
    receive(link, odometry(**fields))
    assert link.telemetry.odometry is None
    assert link.malformed == 1


@pytest.mark.parametrize("narrow", [True, False])
def test_over_a_narrow_line_alone_position_and_attitude_make_odometry(narrow: bool) -> None:
    link = AutopilotLink(1, on_hardware=True)
    assert link.rate is not None
    link.rate.narrow = narrow
    q = quat_from_euler(0.0, 0.0, 0.5)
    attitude = dialect.MAVLink_attitude_quaternion_message(1000, *q, 0.1, 0.2, 0.0)
    receive(link, attitude, dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 0.5, 0.0, -0.1))
    found = link.telemetry.odometry
    if not narrow:
        assert found is None
        nothing = dialect.MAVLink_attitude_quaternion_message(1000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        receive(link, nothing, dialect.MAVLink_local_position_ned_message(1020, nan, 0.0, 0.0, 0.0, 0.0, 0.0))
        assert link.malformed == 0, "what isn't used isn't judged"
        return
    assert found is not None
    assert (found.t_ns, found.pos_uav_ned_m) == (S, (1.0, 2.0, -3.0))
    assert found.vel_uav_ned_mps == pytest.approx((0.5, 0.0, -0.1))
    assert found.q_ned_from_frd == pytest.approx(q)
    for bad in ((nan, 0.0, 0.0), (2e6, 0.0, 0.0)):
        receive(link, dialect.MAVLink_local_position_ned_message(1020, *bad, 0.0, 0.0, 0.0))
    assert link.malformed == 2
    assert link.telemetry.odometry is found


@pytest.mark.parametrize(
    ("var_north_m2", "var_east_m2", "std_m"),
    [(0.04, 0.09, 0.3), (0.09, 0.04, 0.3), (0.0, 0.0, 0.0), (nan, nan, None), (-1.0, -1.0, None), (1e13, 0.0, None)],
)
def test_the_larger_horizontal_variance_gives_the_standard_deviation_of_the_position(
    var_north_m2: float, var_east_m2: float, std_m: float | None
) -> None:
    message = odometry()
    message.pose_covariance = [var_north_m2, *[0.0] * 5, var_east_m2, *[0.0] * 14]
    (received,) = receive(AutopilotLink(1), message).odometry
    assert received.std_pos_m == (None if std_m is None else pytest.approx(std_m))


def test_odometry_of_an_unknown_velocity_frame_and_of_a_time_beyond_all_flights_is_not_believed() -> None:
    link = AutopilotLink(1)
    assert receive(link, odometry(child_frame=dialect.MAV_FRAME_LOCAL_ENU)).odometry == []
    assert receive(link, odometry(t_us=2**61)).odometry == []
    assert link.malformed == 2
    assert receive(link, odometry(child_frame=dialect.MAV_FRAME_LOCAL_NED)).odometry


@pytest.mark.parametrize(("back_ms", "restarted"), [(500, False), (1500, True)])
def test_after_a_step_back_by_more_than_a_second_all_is_learned_anew(back_ms: int, restarted: bool) -> None:
    link = AutopilotLink(1, {"A": 1})
    receive(link, dialect.MAVLink_gps_global_origin_message(473977418, 85455938, 488000, 0))
    link.parameters.confirm("A", *encoded(1))
    batch = receive(link, odometry(9_000_000), odometry(9_000_000 - back_ms * 1000, x=7.0), at_ns=S)
    assert batch.restarted is restarted
    assert [o.pos_uav_ned_m[0] for o in batch.odometry] == ([7.0] if restarted else [1.0])
    assert (link.telemetry.origin_deg is None) is restarted
    assert link.parameters.pending == (("A",) if restarted else ())
    assert link.telemetry.received_wall_ns == S


def hz_of(link: AutopilotLink) -> float | None:
    """Rate of odometry; a function, as mypy takes an attribute for unchanged between two asserts."""
    return None if link.rate is None else link.rate.hz


def test_another_autopilot_gets_fence_and_commands_anew_and_its_rate_is_measured_anew() -> None:
    link = AutopilotLink(1, on_hardware=True)
    assert link.rate is not None
    for number in range(50 * 10):
        link.rate.add(number * S // 50)
        link.rate.update(number * S // 50, None)
    assert hz_of(link) is not None
    link.fence.start([(5001, 3, (47.0, 8.0 + 0.001 * corner)) for corner in range(3)])
    receive(link, dialect.MAVLink_mission_ack_message(1, 191, 0, dialect.MAV_MISSION_TYPE_FENCE))
    assert not link.send_fence(S)
    assert link.command(AutopilotCommand.ARM, 0) and not link.command(AutopilotCommand.ARM, S // 4)
    link.reset()
    assert hz_of(link) is None
    assert link.send_fence(S)
    assert link.command(AutopilotCommand.ARM, S // 4)


def test_a_step_of_the_position_estimate_is_reported_once() -> None:
    link, steps = AutopilotLink(1), []
    for t_us, x, counter in ((1_000_000, 1.0, 0), (1_020_000, 3.5, 1), (1_040_000, 3.5, 1)):
        message = odometry(t_us, x=x, vx=0.0)
        message.reset_counter = counter
        steps.append(receive(link, message).steps_ned_m)
    assert steps == [[], [pytest.approx((2.5, 0.0, 0.0))], []]


def test_datagrams_that_overtook_each_other_are_not_a_restart() -> None:
    link = AutopilotLink(1)
    received = receive(link, odometry(2_000_000), odometry(1_980_000), odometry(2_020_000))
    assert [o.t_ns for o in received.odometry] == [2_000_000_000, 2_020_000_000]
    assert not received.restarted
    assert receive(link, odometry(100_000)).restarted


def test_other_systems_and_components_are_not_the_autopilot() -> None:
    link = AutopilotLink(1)
    heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 1 | 128, 6 << 16, 4, 3)
    receive(link, heartbeat, codec=MavlinkCodec(2, 1))
    receive(link, heartbeat, codec=MavlinkCodec(1, 100))
    assert link.telemetry.received_wall_ns is None
    receive(link, heartbeat)
    assert link.telemetry.armed
    assert link.telemetry.mode == "OFFBOARD"


@pytest.mark.parametrize(
    ("main", "sub", "name"),
    [
        (1, 0, "MANUAL"), (2, 0, "ALTCTL"), (3, 0, "POSCTL"), (5, 0, "ACRO"), (6, 0, "OFFBOARD"), (7, 0, "STABILIZED"),
        (4, 1, "AUTO.READY"), (4, 2, "AUTO.TAKEOFF"), (4, 3, "AUTO.LOITER"), (4, 4, "AUTO.MISSION"), (4, 5, "AUTO.RTL"),
        (4, 6, "AUTO.LAND"), (4, 8, "AUTO.FOLLOW_TARGET"), (4, 9, "AUTO.PRECLAND"), (99, 0, "MODE_99"),
    ],
)  # fmt: skip
def test_modes_have_px4s_names(main: int, sub: int, name: str) -> None:
    """The numbers are those of PX4's `px4_custom_mode.h`."""
    assert mode_name(main << 16 | sub << 24) == name


@pytest.mark.parametrize(
    ("status", "failsafe"),
    [
        (dialect.MAV_STATE_STANDBY, False),
        (dialect.MAV_STATE_ACTIVE, False),
        (dialect.MAV_STATE_CRITICAL, True),
        (dialect.MAV_STATE_EMERGENCY, True),
        (dialect.MAV_STATE_POWEROFF, False),
        (dialect.MAV_STATE_FLIGHT_TERMINATION, True),
    ],
)
@pytest.mark.parametrize("armed", [True, False])
def test_a_heartbeat_says_whether_the_motors_may_run_and_whether_a_failsafe_acts(
    status: int, failsafe: bool, armed: bool
) -> None:
    link = AutopilotLink(1)
    receive(link, dialect.MAVLink_heartbeat_message(2, 12, 1 | (128 if armed else 0), 6 << 16, status, 3))
    assert (link.telemetry.armed, link.telemetry.failsafe) == (armed, failsafe)


@pytest.mark.parametrize("healthy", [True, False])
def test_the_vehicle_is_armable_while_the_autopilots_own_check_passes(healthy: bool) -> None:
    link, check, other = AutopilotLink(1), dialect.MAV_SYS_STATUS_PREARM_CHECK, dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    sensors = check if healthy else other
    receive(link, dialect.MAVLink_sys_status_message(0, 0, sensors, 0, 15_300, -1, 87, 0, 0, 0, 0, 0, 0))
    assert link.telemetry.armable is healthy


@pytest.mark.parametrize(("component", "named"), [(1, 9), (100, None)])
def test_another_autopilot_on_the_link_is_named_and_another_component_is_not(component: int, named: int | None) -> None:
    link = AutopilotLink(1)
    assert link.other_system_id is None
    receive(link, dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3), codec=MavlinkCodec(9, component))
    assert link.other_system_id == named


def test_battery_and_origin_are_converted() -> None:
    link = AutopilotLink(1)
    receive(
        link,
        dialect.MAVLink_sys_status_message(0, 0, 0, 0, 15_300, -1, 87, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_gps_global_origin_message(473977418, -85455938, 488250, 0),
    )
    assert link.telemetry.battery is not None
    assert link.telemetry.battery.voltage_v == pytest.approx(15.3)
    assert link.telemetry.battery.remaining == pytest.approx(0.87)
    assert link.telemetry.origin_deg == pytest.approx((47.3977418, -8.5455938, 488.25))


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "altitude_m", "believed"),
    [
        (89.0, -179.0, 9e4, True),
        (-91.0, 0.0, 0.0, False),
        (91.0, 0.0, 0.0, False),
        (0.0, 181.0, 0.0, False),
        (0.0, -181.0, 0.0, False),
        (0.0, 0.0, 2e5, False),
        (0.0, 0.0, -2e5, False),
    ],
)
def test_an_origin_that_is_nowhere_on_earth_is_left_out(
    latitude_deg: float, longitude_deg: float, altitude_m: float, believed: bool
) -> None:
    link = AutopilotLink(1)
    numbers = (round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1e3))
    receive(link, dialect.MAVLink_gps_global_origin_message(*numbers, 0))
    assert (link.telemetry.origin_deg is not None) is believed


@pytest.mark.parametrize(("state", "landed"), [(0, None), (1, True), (2, False), (3, False), (4, False)])
def test_the_vehicle_has_landed_when_the_autopilot_says_that_it_is_on_the_ground(
    state: int, landed: bool | None
) -> None:
    link = AutopilotLink(1)
    receive(link, dialect.MAVLink_extended_sys_state_message(0, 2 if landed else 1))
    receive(link, dialect.MAVLink_extended_sys_state_message(0, state))
    assert link.telemetry.landed is landed


def test_chunks_of_another_text_and_texts_without_chunks_are_texts_of_their_own() -> None:
    link = AutopilotLink(1)
    for text, text_id, chunk in ((b"one", 7, 0), (b"two", 8, 1), (b"three", 0, 0), (b"four", 0, 1)):
        receive(link, dialect.MAVLink_statustext_message(2, text, text_id, chunk))
        assert link.telemetry.warning == text.decode()


@pytest.mark.parametrize(("percent", "remaining"), [(0, 0.0), (100, 1.0), (-1, None), (101, None)])
def test_a_charge_that_is_no_percentage_is_unknown(percent: int, remaining: float | None) -> None:
    link = AutopilotLink(1)
    receive(link, dialect.MAVLink_sys_status_message(0, 0, 0, 0, 14_000, -1, percent, 0, 0, 0, 0, 0, 0))
    assert link.telemetry.battery is not None
    assert link.telemetry.battery.remaining == remaining
    receive(link, dialect.MAVLink_sys_status_message(0, 0, 0, 0, 0xFFFF, -1, -1, 0, 0, 0, 0, 0, 0))
    assert link.telemetry.battery is None


def test_a_warning_in_chunks_is_put_together_and_explains_a_refusal_for_a_while() -> None:
    link = AutopilotLink(1)
    link.command(AutopilotCommand.ARM, 0)
    receive(
        link,
        dialect.MAVLink_statustext_message(2, b"Arming denied: the estimator has not yet converged", 7, 0),
        dialect.MAVLink_statustext_message(2, b", wait", 7, 1),
        dialect.MAVLink_statustext_message(6, b"just so you know"),
        dialect.MAVLink_command_ack_message(400, 1, 0, 0, 1, 191),
    )
    failure = "arming temporarily rejected; Arming denied: the estimator has not yet converged, wait"
    assert link.command_failure(S) == failure
    assert link.command_failure(20 * S) == "arming temporarily rejected"


def test_an_order_is_repeated_until_it_is_acknowledged_to_us() -> None:
    link = AutopilotLink(1)
    assert link.command(AutopilotCommand.ARM, 0)
    assert not link.command(AutopilotCommand.ARM, S // 4)
    assert link.command(AutopilotCommand.ARM, S // 2)
    receive(link, dialect.MAVLink_command_ack_message(400, 0, 0, 0, 255, 190), at_ns=S // 2)
    receive(link, dialect.MAVLink_command_ack_message(400, 0, 0, 0, 1, 190), at_ns=S // 2)
    receive(link, dialect.MAVLink_command_ack_message(400, 0, 0, 0, 0, 0), at_ns=S // 2)
    receive(link, dialect.MAVLink_command_ack_message(176, 0, 0, 0, 1, 191), at_ns=S // 2)
    assert acknowledged(link) is None
    receive(link, dialect.MAVLink_command_ack_message(400, 0, 0, 0, 1, 191), at_ns=S // 2)
    assert acknowledged(link) is AutopilotCommand.ARM
    assert not link.command(AutopilotCommand.ARM, S + S // 2)
    assert link.command(AutopilotCommand.ARM, 2 * S), "acknowledged, but without effect"
    assert link.command(AutopilotCommand.DISARM, 2 * S)
    assert acknowledged(link) is None


def test_the_bridge_sends_a_heartbeat_once_a_second_and_requests_its_telemetry() -> None:
    rig = Rig()
    sent: list[MavMessage] = []
    handle = rig.autopilot.handle
    reader = MavlinkCodec(1, 1)

    def record(data: bytes) -> bytes:
        sent.extend(reader.parse(data))
        return handle(data)

    rig.autopilot.handle = record  # type: ignore[method-assign]
    rig.run(4.0)
    heartbeats = [m for m in sent if m.get_msgId() == 0]
    assert len(heartbeats) == 4
    assert (heartbeats[0].type, heartbeats[0].get_srcSystem(), heartbeats[0].get_srcComponent()) == (18, 1, 191)
    commands = [m for m in sent if m.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG]
    intervals = [m for m in commands if m.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL]
    assert {m.param1: m.param2 for m in intervals} == INTERVALS_US


def test_a_bridge_that_starts_after_the_autopilot_requests_the_origin_which_was_sent_before() -> None:
    rig = Rig()
    rig.autopilot.origin_sent = True
    rig.run(0.1)
    assert rig.bridge._link.telemetry.origin_deg == pytest.approx((47.3977418, 8.5455938, 488.0))
    assert rig.autopilot.origin_requests == 1


def test_a_missing_origin_is_requested_once_a_second_and_a_known_one_every_five_seconds() -> None:
    link = AutopilotLink(1)
    assert [t_s for t_s in range(4) if link.request_origin(t_s * S)] == [0, 1, 2, 3]
    receive(link, dialect.MAVLink_gps_global_origin_message(473977418, 85455938, 488000, 0))
    assert [t_s for t_s in range(4, 16) if link.request_origin(t_s * S)] == [8, 13]
    link.reset()
    assert link.request_origin(16 * S), "another autopilot"


def test_the_critical_level_of_the_battery_is_requested_every_two_seconds_until_it_is_known() -> None:
    link, ms = AutopilotLink(1), 1_000_000
    assert [bool(link.request_battery_critical(at * ms)) for at in (0, 20, 1980, 2000, 2020, 4000)] == [
        True, False, False, True, False, True,
    ]  # fmt: skip
    link.telemetry.battery_critical = 0.07
    assert link.request_battery_critical(6000 * ms) == b""
    link.reset()
    assert link.request_battery_critical(6020 * ms), "another autopilot"


@pytest.mark.parametrize(
    ("name", "value", "critical"),
    [
        (b"BAT_CRIT_THR", 0.0, 0.0),
        (b"BAT_CRIT_THR", 1.0, 1.0),
        (b"BAT_CRIT_THR", 1.5, None),
        (b"BAT_CRIT_THR", -0.1, None),
        (b"BAT_CRIT_THR", nan, None),
        (b"BAT_LOW_THR", 0.15, None),
    ],
)
def test_a_share_of_the_battery_in_its_own_parameter_alone_is_its_critical_level(
    name: bytes, value: float, critical: float | None
) -> None:
    link = AutopilotLink(1)
    receive(link, dialect.MAVLink_param_value_message(name, value, dialect.MAV_PARAM_TYPE_REAL32, 1, 0))
    assert link.telemetry.battery_critical == critical


def test_the_version_of_a_real_flight_controller_is_requested_every_two_seconds_until_it_is_known() -> None:
    link, ms = AutopilotLink(1, on_hardware=True), 1_000_000
    begin_ms = 1000
    assert [bool(link.request_version((begin_ms + at) * ms)) for at in (0, 20, 1980, 2000, 2020, 4000)] == [
        True, False, False, True, False, True,
    ]  # fmt: skip
    nothing = [0] * 8
    receive(link, dialect.MAVLink_autopilot_version_message(0, 1 << 24 | 15 << 16, 0, 0, 0, *[nothing] * 3, 0, 0, 0))
    assert link.request_version(7000 * ms) == b""
    link.reset()
    assert link.request_version(7020 * ms), "another flight controller"


def test_the_same_flight_gives_the_same_bytes() -> None:
    def flight() -> list[object]:
        rig = Rig().fly()
        rig.go("go_to", Phase.GO_TO)
        rig.run(1.0)
        return list(rig.outputs)

    assert flight() == flight()


def distance(t_ms: int = 1000, range_cm: int = 234, *, orientation: int = 25, quality: int = 0) -> MavMessage:
    return dialect.MAVLink_distance_sensor_message(
        t_ms, 15, 1000, range_cm, 0, 0, orientation, 255, signal_quality=quality
    )


@pytest.mark.parametrize(
    ("message", "range_m"),
    [
        (distance(), 2.34),
        (distance(range_cm=14), None),
        (distance(range_cm=1001), None),
        (distance(quality=1), None),
        (distance(quality=100), 2.34),
        (distance(range_cm=15), 0.15),
        (distance(range_cm=1000), 10.0),
        (dialect.MAVLink_distance_sensor_message(1000, 0, 1000, 0, 0, 0, 25, 255), None),
    ],
)
def test_a_range_downwards_is_the_altimeters_in_the_autopilots_time(message: MavMessage, range_m: float | None) -> None:
    (altimeter,) = receive(AutopilotLink(1, on_hardware=True), message).altimeter
    assert (altimeter.t_ns, altimeter.range_m) == (S, range_m)


def test_a_range_to_the_front_and_one_that_comes_twice_are_no_altimeter_readings() -> None:
    link = AutopilotLink(1, on_hardware=True)
    assert not receive(link, distance(orientation=0)).altimeter
    assert len(receive(link, distance(), distance()).altimeter) == 1


def test_ranges_are_requested_of_a_real_vehicles_autopilot_only() -> None:
    for link, wanted in ((AutopilotLink(1, on_hardware=True), True), (AutopilotLink(1), False)):
        asked = {int(message.param1) for message in MavlinkCodec(1, 1).parse(link.request_intervals())}
        assert (dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR in asked) is wanted


def test_replies_to_another_programs_fence_are_not_ours() -> None:
    link, kind = AutopilotLink(1), dialect.MAV_MISSION_TYPE_FENCE
    link.fence.start([(5001, 3, (47.0, 8.0 + 0.001 * corner)) for corner in range(3)])
    receive(link, dialect.MAVLink_mission_ack_message(255, 190, dialect.MAV_MISSION_ACCEPTED, kind))
    assert not link.fence.done
    receive(link, dialect.MAVLink_mission_ack_message(1, 191, dialect.MAV_MISSION_ACCEPTED, kind))
    assert link.fence.done
