"""The bridge beside a real flight controller: it is the master of vehicle time, and says in words what is missing."""

from typing import Any, Literal

import pytest
from msgspec.structs import replace

from jezero.base.frames import q_frd_from_gimbal
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.runtime.service import Health, Publish, Send
from jezero.schemas.commands import CameraPitch, Hover, Kill, Phase
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ALTIMETER, CAMERA_PITCH, CLOCK, HOVER, KILL
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from tests.services.vehicle_bridge.rig import MODES, FakeAutopilot, Rig

LINK = "serial:/dev/ttyACM0:57600"
CONFIG = replace(VehicleBridgeConfig(), link=LINK, parameters={"MPC_XY_VEL_P_ACC": 4.0})


def real() -> Rig:
    return Rig(CONFIG)


def health_of(rig: Rig) -> str:
    """Sentence of the last health."""
    return [output.text for output in rig.outputs if isinstance(output, Health)][-1]


def sent_by(rig: Rig) -> list[Any]:
    """All messages that the bridge has sent to the flight controller."""
    return MavlinkCodec(255, 1).parse(b"".join(output.data for output in rig.outputs if isinstance(output, Send)))


def interval_requests(rig: Rig) -> list[Any]:
    """Requests of the bridge that a message comes regularly."""
    commands = (m for m in sent_by(rig) if m.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG)
    return [command for command in commands if command.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL]


def requested_ids(rig: Rig) -> set[int]:
    """Kinds of the messages that the bridge has requested to come regularly."""
    return {int(request.param1) for request in interval_requests(rig)}


def clock_error_ns(rig: Rig) -> int:
    """Vehicle time by the last clock minus that of the controller."""
    clock = rig.clocks[-1]
    return clock.t_ns + rig.box.wall_ns - clock.wall_ns - rig.t_ns


def test_vehicle_time_is_the_controllers_and_the_vehicle_flies() -> None:
    rig = real().ready()
    assert abs(clock_error_ns(rig)) <= 20_000_000  # telemetry comes once a step of 20 ms
    rig.run(10.0)
    assert rig.status.t_ns == pytest.approx(rig.t_ns, abs=120e6)
    rig.go("takeoff", Phase.TAKEOFF)
    assert rig.status.code == StatusCode.TAKEOFF


def test_the_clock_is_stamped_with_the_time_of_the_computer_with_the_stalls_of_the_bridge() -> None:
    """Another process, which did not stall with the bridge, compares the stamp with its own monotonic clock."""
    rig = real()
    rig.box.stalled_ns = 3_000_000_000
    rig.ready()
    assert rig.clocks[-1].wall_ns - rig.box.wall_ns == pytest.approx(rig.box.stalled_ns, abs=500e6)


def test_ranges_of_the_flight_controller_are_published_as_the_altimeters() -> None:
    rig = real().ready()
    rig.outputs.clear()
    down = dialect.MAV_SENSOR_ROTATION_PITCH_270
    rig.autopilot.unasked = rig.autopilot.codec.pack(
        dialect.MAVLink_distance_sensor_message(rig.autopilot.t_us // 1000, 20, 1000, 300, 0, 0, down, 255)
    )
    rig.step()
    published = [output.message for output in rig.outputs if isinstance(output, Publish)]
    assert [message.range_m for message in published if isinstance(message, Altimeter)] == [3.0]


def test_the_camera_on_a_gimbal_is_turned_as_commanded() -> None:
    robot = VehicleConfig(camera=CameraMountConfig(gimbal="mavlink"))
    rig = Rig(CONFIG, robot).ready()

    def aimed() -> tuple[float, ...]:
        kind = dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE
        return tuple([message for message in sent_by(rig) if message.get_msgId() == kind][-1].q)

    assert aimed() == pytest.approx(q_frd_from_gimbal(robot.camera.pitch_rest_rad, 0.0), abs=1e-3)
    command = CameraPitch(t_ns=rig.t_ns, pitch_camera_rad=-0.7)
    rig.run(0.5, lambda: rig.box.put(CAMERA_PITCH, command))
    assert aimed() == pytest.approx(q_frd_from_gimbal(-0.7, 0.0), abs=1e-3)


def test_a_real_controller_gets_no_parameters_of_the_simulated_vehicle() -> None:
    rig = real()
    rig.autopilot.parameters = {"MPC_XY_VEL_P_ACC": 1.8}
    rig.run(10.0)
    assert rig.autopilot.set_parameters == []


def test_a_boot_in_flight_begins_a_new_epoch_and_ends_the_goal_with_its_reason() -> None:
    rig = real().fly()
    rig.go("go_to", Phase.GO_TO)
    epoch_id = rig.status.epoch_id
    rig.t_ns = 500_000_000
    rig.autopilot.armed, rig.autopilot.mode = False, 4 << 16 | 3 << 24
    rig.run(2.0)
    assert rig.status.epoch_id == epoch_id + 1
    assert rig.status.code in (StatusCode.IDLE, StatusCode.EXTERNAL)
    assert any("the flight controller was booted anew" in status.text for status in rig.statuses)
    assert abs(clock_error_ns(rig)) <= 20_000_000


@pytest.mark.parametrize(
    ("link", "gimbal", "points"),
    [(LINK, "mavlink", True), (LINK, "fixed", False), ("", "mavlink", False), ("", "fixed", False)],
)
def test_only_a_real_vehicles_bridge_publishes_time_and_ranges_and_points_the_camera_if_it_has_a_gimbal(
    link: str, gimbal: Literal["fixed", "mavlink"], points: bool
) -> None:
    robot = VehicleConfig(camera=CameraMountConfig(gimbal=gimbal))
    spec = Rig(replace(VehicleBridgeConfig(), link=link), robot).bridge.spec
    assert (CAMERA_PITCH in spec.inputs) is points
    assert (CLOCK in spec.outputs) is (ALTIMETER in spec.outputs) is bool(link)


def test_what_is_missing_is_said_with_the_links_name() -> None:
    rig = real()
    rig.autopilot.silent = True
    rig.run(3.0)
    assert rig.status.not_ready_reason == (
        f"nothing comes from the flight controller at {LINK}: is it plugged in and switched on?"
    )
    rig.autopilot.silent, rig.autopilot.answers_timesync = False, False
    rig.run(2.0)
    assert rig.status.not_ready_reason == f"the flight controller at {LINK} doesn't answer TIMESYNC yet"


def test_another_system_id_is_named_with_the_setting() -> None:
    rig = real()
    rig.autopilot = FakeAutopilot(system_id=9)
    rig.run(3.0)
    assert "system id 9: set system_id in vehicle_bridge.toml" in rig.status.not_ready_reason


def test_odometry_that_comes_too_rarely_is_named_with_rate_line_and_parameter() -> None:
    rig = real().ready()
    telemetry = rig.autopilot.telemetry

    def every_twelfth() -> bytes:
        return telemetry() if rig.t_ns // 20_000_000 % 12 == 0 else b""

    rig.autopilot.telemetry = every_twelfth  # type: ignore[method-assign]
    rig.run(30.0)
    assert f"odometry comes at 4 Hz over {LINK}, and any flight needs 8 Hz" in rig.status.not_ready_reason
    assert "MAV_1_RATE" in rig.status.not_ready_reason
    assert not rig.status.ready


def test_the_health_says_that_no_rangefinder_is_there_until_one_is() -> None:
    rig = real().ready()
    missing = "the flight controller sends no DISTANCE_SENSOR: without a rangefinder nothing lands"

    def health() -> str:
        return [output.text for output in rig.outputs if isinstance(output, Health)][-1]

    rig.run(2.0)
    assert missing in health()
    down = dialect.MAV_SENSOR_ROTATION_PITCH_270
    rig.autopilot.unasked = rig.autopilot.codec.pack(
        dialect.MAVLink_distance_sensor_message(rig.autopilot.t_us // 1000, 20, 1000, 300, 0, 0, down, 255)
    )
    rig.run(2.0)
    assert missing not in health()


def test_a_line_that_is_enough_to_fly_may_be_too_little_for_a_landing_on_the_rover() -> None:
    rig = real().fly()
    telemetry = rig.autopilot.telemetry

    def every_fifth() -> bytes:
        return telemetry() if rig.t_ns // 20_000_000 % 5 == 0 else b""

    rig.autopilot.telemetry = every_fifth  # type: ignore[method-assign]
    rig.run(30.0)
    refusal = rig.acquire("land_on_spot").reason
    assert refusal.startswith(
        f"odometry comes at 10 Hz over {LINK}, and land on spot needs 15 Hz: raise PX4's SER_TEL2_BAUD"
    )
    assert refusal.endswith("jezero return lands with 8 Hz")
    health = [output for output in rig.outputs if isinstance(output, Health)][-1]
    assert health.state == "degraded"
    assert f"; odometry comes at 10 Hz over {LINK}, and land on spot needs 15 Hz" in health.text
    assert rig.acquire("return_home").granted


def test_ardupilot_is_refused_with_what_it_lacks_and_gets_no_command() -> None:
    rig = real()
    rig.autopilot.kind = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    rig.run(10.0)
    assert not rig.status.ready
    assert rig.status.not_ready_reason.startswith("the flight controller runs ArduPilot, and jezero flies PX4 only")
    assert "no ODOMETRY" in rig.status.not_ready_reason
    assert rig.odometry == []  # although it sends what would be read as position and attitude
    assert "runs ArduPilot" in rig.acquire("takeoff", "g1").reason
    assert not rig.request(HOVER, Hover()).hover_mode
    assert rig.autopilot.commands == rig.autopilot.setpoints == []


def test_a_flying_ardupilot_is_not_taken_back() -> None:
    rig = real()
    rig.autopilot.kind, rig.autopilot.armed, rig.autopilot.landed = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, True, False
    rig.run(10.0)
    assert not rig.request(HOVER, Hover()).hover_mode
    rig.run(2.0)
    assert rig.autopilot.commands == rig.autopilot.setpoints == []


def test_px4_in_its_place_is_flown() -> None:
    rig = real()
    rig.autopilot.kind = dialect.MAV_AUTOPILOT_GENERIC
    rig.run(10.0)
    assert "runs no PX4 (its HEARTBEAT names autopilot 0)" in rig.status.not_ready_reason
    rig.autopilot.kind = dialect.MAV_AUTOPILOT_PX4
    rig.run(10.0)
    assert rig.status.ready, rig.status.not_ready_reason
    assert rig.bridge._link.rate is not None and not rig.bridge._link.rate.narrow


def test_a_narrow_line_gets_no_more_setpoints_than_it_carries() -> None:
    rig = real().ready()
    assert rig.bridge._link.rate is not None
    rig.bridge._link.rate.narrow = True
    control_id = rig.acquire("takeoff").control_id
    rig.autopilot.setpoints.clear()
    rig.run(2.0, lambda: rig.setpoint(control_id, Phase.TAKEOFF))  # 50 a second
    assert 45 <= len(rig.autopilot.setpoints) <= 61
    assert "; the line is too narrow for ODOMETRY: position and attitude instead, " in health_of(rig)


@pytest.mark.parametrize(("pilot", "silent", "requested"), [(False, False, 2), (True, False, 0), (True, True, 2)])
def test_telemetry_is_requested_every_five_seconds_but_not_while_a_pilot_flies_and_it_arrives(
    pilot: bool, silent: bool, requested: int
) -> None:
    """An autopilot that has restarted has forgotten the request."""
    rig = Rig().fly() if pilot else Rig().ready()
    if pilot:
        rig.autopilot.mode = MODES["POSCTL"]
        rig.run(0.1)
    rig.autopilot.silent = silent
    rig.outputs.clear()
    for _ in range(10):
        rig.box.wall_ns += 1_000_000_000
        rig.run(0.04)
    kinds = [int(message.param1) for message in interval_requests(rig)]
    assert kinds.count(dialect.MAVLINK_MSG_ID_ODOMETRY) == requested


def test_nothing_is_requested_of_a_controller_that_is_silent_or_that_jezero_does_not_fly() -> None:
    silent, other = real(), real()
    silent.autopilot.silent = True
    other.autopilot.kind = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    for rig in (silent, other):
        rig.run(1.0)
        assert interval_requests(rig) == []
        assert rig.autopilot.read_parameters == []


def test_smaller_messages_are_requested_at_once_of_a_line_that_brings_too_little_odometry() -> None:
    rig = real()
    telemetry = rig.autopilot.telemetry

    def every_fifth() -> bytes:
        return telemetry() if rig.t_ns // 20_000_000 % 5 == 0 else b""

    rig.autopilot.telemetry = every_fifth  # type: ignore[method-assign]
    rig.run(5.8)
    assert dialect.MAVLINK_MSG_ID_ODOMETRY in requested_ids(rig)
    assert dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED not in requested_ids(rig)
    rig.run(0.6)
    small = {dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION}
    assert small <= requested_ids(rig)


@pytest.mark.parametrize(("delay_ms", "narrow"), [(20, False), (100, True)])
def test_a_line_that_is_slow_to_reply_is_full_although_enough_odometry_comes(delay_ms: int, narrow: bool) -> None:
    rig = real()
    handle, telemetry = rig.autopilot.handle, rig.autopilot.telemetry
    late: list[tuple[int, bytes]] = []

    def keep_replies(data: bytes) -> bytes:
        late.append((rig.t_ns + delay_ms * 1_000_000, handle(data)))
        return b""

    def with_late_replies() -> bytes:
        due = [each for each in late if each[0] <= rig.t_ns]
        late[:] = [each for each in late if each[0] > rig.t_ns]
        return b"".join(reply for _, reply in due) + telemetry()

    rig.autopilot.handle = keep_replies  # type: ignore[method-assign]
    rig.autopilot.telemetry = with_late_replies  # type: ignore[method-assign]
    rig.run(8.0)
    assert (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED in requested_ids(rig)) is narrow


def test_nothing_takes_off_before_the_rate_is_known() -> None:
    rig = real()
    rig.run(3.0)
    assert f"the rate of odometry over {LINK} is being measured" in rig.status.not_ready_reason
    assert "is being measured" in rig.acquire("takeoff").reason
    rig.run(6.0)
    assert rig.status.ready, rig.status.not_ready_reason


def test_a_kill_reaches_ardupilot_too() -> None:
    rig = real()
    rig.autopilot.kind, rig.autopilot.armed = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, True
    rig.run(3.0)
    rig.post(KILL, Kill(confirm=True, vehicle="uav1"))
    rig.run(1.0)
    assert not rig.autopilot.armed


def test_the_version_of_px4_stands_in_health() -> None:
    rig = real().ready()
    rig.run(3.0)
    assert "; PX4 1.15.2; the flight controller sends no DISTANCE_SENSOR" in health_of(rig)


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (1 << 24 | 19 << 16, "PX4 1.19.0, which jezero was not tried with"),
        (2 << 24, "PX4 2.0.0, which jezero was not tried with"),
        (0, "the flight controller doesn't name its version"),
    ],
)
def test_a_version_that_was_not_tried_is_named_and_flies(version: int, words: str) -> None:
    rig = real()
    rig.autopilot.version = version
    rig.ready().run(3.0)
    assert words in health_of(rig)
    rig.go("takeoff", Phase.TAKEOFF)
    assert rig.status.code == StatusCode.TAKEOFF


def test_an_older_version_than_the_oldest_that_was_tried_takes_nothing_off() -> None:
    rig = real()
    rig.autopilot.version = 1 << 24 | 14 << 16 | 3 << 8
    rig.run(10.0)
    assert not rig.status.ready
    assert rig.status.not_ready_reason == (
        "the flight controller has PX4 1.14.3, which was never tried: install 1.15 or newer"
    )


def test_the_autopilot_of_the_simulation_is_not_asked_for_its_version() -> None:
    rig = Rig().ready()
    rig.autopilot.version = 1 << 24 | 14 << 16
    rig.run(5.0)
    assert rig.status.ready
