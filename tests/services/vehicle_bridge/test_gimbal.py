"""A camera on a gimbal: claimed, pointed against the horizon, measured against the body; and the twin's manager."""

from math import cos, pi, radians, sin

import pytest
from msgspec.structs import replace

from jezero.base.frames import (
    Quat,
    gimbal_angles,
    q_frd_from_gimbal,
    quat_from_euler,
    quat_multiply,
    quat_normalize,
    quat_rotate,
)
from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.runtime.service import Health, Publish
from jezero.schemas.commands import CameraPitch
from jezero.schemas.sensors import CameraAttitude
from jezero.schemas.topics import CAMERA_ATTITUDE, CAMERA_PITCH
from jezero.services.autopilot.gimbal import NOBODY, GimbalManager
from jezero.services.vehicle_bridge.autopilot_link import AutopilotLink
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.gimbal import SILENT_NS, GimbalClient
from tests.services.vehicle_bridge.rig import Rig

BRIDGE, MANAGER, DOWN = (1, 191), (1, 1), (-1.5708, 0.0)
TILTED = quat_from_euler(0.2, -0.15, 2.4)
"""A vehicle that leans, with its nose to the south-east."""
CLAIM = dialect.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
MS = 1_000_000
S = 1000 * MS


def parsed(component: int, message: object) -> object:
    """A message as another one receives it from a component."""
    (received,) = MavlinkCodec(1, 9).parse(MavlinkCodec(1, component).pack(message))
    return received


def attitude_status(q: Quat, flags: int, failure: int = 0) -> object:
    nothing = float("nan")
    return parsed(
        154,
        dialect.MAVLink_gimbal_device_attitude_status_message(
            0, 0, 5, flags, list(q), nothing, nothing, nothing, failure
        ),
    )


@pytest.mark.parametrize("pitch_deg", [-90.0, -60.0, -120.0, -1.0, 0.0, 20.0])
@pytest.mark.parametrize("roll_deg", [-40.0, 0.0, 25.0])
def test_angles_of_the_camera_and_attitude_of_its_gimbal_are_the_same(pitch_deg: float, roll_deg: float) -> None:
    angles = radians(pitch_deg), radians(roll_deg)
    assert gimbal_angles(q_frd_from_gimbal(*angles)) == pytest.approx(angles, abs=1e-6)


def test_a_positive_roll_turns_the_view_to_the_left_and_a_camera_at_rest_looks_down() -> None:
    assert quat_rotate(q_frd_from_gimbal(-pi / 2, 0.0), (1.0, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)
    assert quat_rotate(q_frd_from_gimbal(-pi / 2, 0.3), (1.0, 0.0, 0.0))[1] < 0.0


def test_the_gimbal_is_claimed_until_it_is_ours_and_not_after() -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    claims = [m for i in range(30) for m in client.due(TILTED, i * 100 * MS) if m.get_msgId() == 76]
    assert [(m.command, m.param1, m.param2, m.param3, m.param7) for m in claims] == [(CLAIM, 1.0, 191.0, -1.0, 0.0)] * 3
    client.on_status(dialect.MAVLink_gimbal_manager_status_message(0, 0, 1, *BRIDGE, 0, 0))
    client.on_attitude(attitude_status((1.0, 0.0, 0.0, 0.0), 32), 1, TILTED, 3_000 * MS)
    assert not [m for i in range(19) for m in client.due(TILTED, (3_000 + i * 100) * MS) if m.get_msgId() == 76]
    assert client.problem(3_000 * MS) == ""
    client.on_status(dialect.MAVLink_gimbal_manager_status_message(0, 0, 1, 255, 190, 0, 0))
    assert client.problem(3_000 * MS) == "MAVLink system 255, component 190 is in control of the gimbal"


def test_a_gimbal_that_has_fallen_silent_is_claimed_again() -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    client.on_status(dialect.MAVLink_gimbal_manager_status_message(0, 0, 1, *BRIDGE, 0, 0))
    client.on_attitude(attitude_status((1.0, 0.0, 0.0, 0.0), 32), 1, TILTED, 0)
    claims_ms = [ms for ms in range(0, 6000, 100) for m in client.due(TILTED, ms * MS) if m.get_msgId() == 76]
    assert claims_ms and min(claims_ms) > 1000


def test_a_command_is_sent_against_the_horizon_and_comes_back_as_the_same_angles() -> None:
    client, manager = GimbalClient(BRIDGE, MANAGER, DOWN), GimbalManager()
    assert manager.configure((1.0, 191.0), BRIDGE)
    for i in range(40):
        t_ms = 50 * i
        client.point([CameraPitch(t_ns=1, pitch_camera_rad=-0.7, roll_camera_rad=0.2)], t_ms * MS)
        for message in client.due(TILTED, t_ms * MS):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE:
                manager.on_attitude(parsed(191, message), TILTED)
        manager.move(t_ms * 1000)
    assert (manager.pitch_rad, manager.roll_rad) == pytest.approx((-0.7, 0.2), abs=1e-6)
    measured = client.on_attitude(attitude_status(manager.q_level(TILTED), 12 | 32), 77, TILTED, 0)
    assert measured.t_ns == 77
    assert (measured.pitch_camera_rad, measured.roll_camera_rad) == pytest.approx((-0.7, 0.2), abs=1e-6)


def test_a_yaw_against_north_is_understood_too() -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    q_ned = quat_normalize(quat_multiply(TILTED, q_frd_from_gimbal(-0.7, 0.2)))
    q_level = quat_multiply(quat_from_euler(0.0, 0.0, -2.4), q_ned)
    # Yaw in the earth frame; older: yaw locked; both flags; against the heading, although the yaw is locked.
    for flags, q in ((64, q_ned), (16, q_ned), (64 | 16, q_ned), (32 | 16, q_level)):
        measured = client.on_attitude(attitude_status(q, flags), 1, TILTED, 0)
        assert (measured.pitch_camera_rad, measured.roll_camera_rad) == pytest.approx((-0.7, 0.2), abs=1e-6)


def test_the_gimbal_is_pointed_about_twenty_times_a_second() -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    pointed = [m for ms in range(0, 1000, 10) for m in client.due(TILTED, ms * MS) if m.get_msgId() == 282]
    assert len(pointed) == 20
    locks = dialect.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | dialect.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
    flags = locks | dialect.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
    assert {(m.target_system, m.target_component, m.flags) for m in pointed} == {(*MANAGER, flags)}


@pytest.mark.parametrize(("pitch_deg", "straight_down"), [(-70.0, False), (-88.0, True), (-115.0, True)])
def test_a_steep_camera_is_sent_straight_down(pitch_deg: float, straight_down: bool) -> None:
    """There roll and yaw are one, and PX4, which limits each of them, would turn the gimbal to and fro."""
    client, level = GimbalClient(BRIDGE, MANAGER, DOWN), quat_from_euler(0.0, 0.0, 0.0)
    client.point([CameraPitch(t_ns=1, pitch_camera_rad=radians(pitch_deg))], 0)
    (message,) = [m for m in client.due(level, 0) if m.get_msgId() == 282]
    view = quat_rotate(tuple(message.q), (1.0, 0.0, 0.0))
    expected = (0.0, 0.0, 1.0) if straight_down else (cos(radians(pitch_deg)), 0.0, -sin(radians(pitch_deg)))
    assert view == pytest.approx(expected, abs=1e-6)


def test_the_newest_of_several_commands_counts() -> None:
    client, level = GimbalClient(BRIDGE, MANAGER, DOWN), quat_from_euler(0.0, 0.0, 0.0)
    client.point([CameraPitch(t_ns=number, pitch_camera_rad=-0.1 * number) for number in (1, 2, 3)], 0)
    client.point([], 10 * MS)
    (message,) = [m for m in client.due(level, 10 * MS) if m.get_msgId() == 282]
    assert gimbal_angles(tuple(message.q)) == pytest.approx((-0.3, 0.0), abs=1e-6)


def linked() -> tuple[AutopilotLink, GimbalClient, MavlinkCodec]:
    """A link to an autopilot that manages a gimbal, and the codec of the autopilot."""
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    return AutopilotLink(1, on_hardware=True, gimbal=client), client, MavlinkCodec(1, 1)


def odometry_of_a_level_vehicle() -> object:
    nothing = [float("nan")] * 21
    return dialect.MAVLink_odometry_message(
        1_000_000, 1, 1, 0.0, 0.0, -3.0, [1.0, 0.0, 0.0, 0.0], *[0.0] * 6, nothing, nothing, 0, 8, 100
    )


def test_an_attitude_of_the_gimbal_counts_with_that_of_the_vehicle_only() -> None:
    link, client, autopilot = linked()
    gimbal, nan = MavlinkCodec(1, 154), float("nan")

    def receive(q: Quat) -> list[CameraAttitude]:
        message = dialect.MAVLink_gimbal_device_attitude_status_message(0, 0, 5, 32, list(q), nan, nan, nan, 0)
        return link.receive(gimbal.pack(message), S, S, 1).camera

    down = q_frd_from_gimbal(-1.0, 0.0)
    assert receive(down) == []
    assert link.point_camera(S) == b"", "the attitude of the vehicle isn't known"
    link.receive(autopilot.pack(odometry_of_a_level_vehicle()), S, S, 1)
    assert link.point_camera(S)
    assert receive((0.0, 0.0, 0.0, 0.0)) == []
    assert link.malformed == 1
    (measured,) = receive(down)
    assert measured.pitch_camera_rad == pytest.approx(-1.0, abs=1e-6)
    assert client.problem(S) == ""


def test_the_manager_says_over_the_link_who_is_in_control() -> None:
    link, client, autopilot = linked()
    status = dialect.MAVLink_gimbal_manager_status_message(0, 0, 1, 255, 190, 0, 0)
    link.receive(autopilot.pack(status), S, S, 1)
    assert "MAVLink system 255, component 190 is in control" in client.problem(S)


@pytest.mark.parametrize("has_gimbal", [True, False])
def test_a_gimbals_own_messages_are_no_sign_of_life_of_the_autopilot(has_gimbal: bool) -> None:
    """Also where the settings name no gimbal: it may turn the camera without jezero."""
    link, autopilot = linked()[0] if has_gimbal else AutopilotLink(1, on_hardware=True), MavlinkCodec(1, 1)
    gimbal, nan = MavlinkCodec(1, 154), float("nan")
    level = [1.0, 0.0, 0.0, 0.0]
    attitude = dialect.MAVLink_gimbal_device_attitude_status_message(0, 0, 5, 32, level, nan, nan, nan, 0)
    for message in (dialect.MAVLink_heartbeat_message(26, 8, 0x80, 0, 4, 3), attitude):
        link.receive(gimbal.pack(message), S, S, 1)
    assert (link.telemetry.received_wall_ns, link.refusal, link.telemetry.armed) == (None, "", None)
    link.receive(autopilot.pack(dialect.MAVLink_heartbeat_message(2, 12, 0x80, 0, 4, 3)), S, S, 1)
    assert link.telemetry.received_wall_ns == S
    assert link.telemetry.armed


@pytest.mark.parametrize("has_gimbal", [True, False])
def test_the_gimbals_messages_are_requested_where_there_is_one(has_gimbal: bool) -> None:
    link = linked()[0] if has_gimbal else AutopilotLink(1, on_hardware=True)
    requested = {int(m.param1) for m in MavlinkCodec(1, 1).parse(link.request_intervals())}
    messages = {
        dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
        dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS,
    }
    assert (requested & messages == messages) is has_gimbal
    assert dialect.MAVLINK_MSG_ID_ODOMETRY in requested


def test_without_commands_the_camera_returns_to_rest() -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    client.point([CameraPitch(t_ns=1, pitch_camera_rad=-0.7)], 0)
    level = (1.0, 0.0, 0.0, 0.0)

    def sent(t_ms: int) -> tuple[float, float]:
        (message,) = [m for m in client.due(level, t_ms * MS) if m.get_msgId() == 282]
        return gimbal_angles(tuple(message.q))

    assert sent(500)[0] == pytest.approx(-0.7)
    assert sent(1_100)[0] == pytest.approx(-pi / 2, abs=1e-4)


@pytest.mark.parametrize("vehicle", [TILTED, quat_from_euler(0.1, 0.0, 0.0), quat_from_euler(0.0, -0.3, 1.0)])
def test_a_leaning_vehicle_at_rest_sends_the_camera_straight_down_and_never_around(vehicle: Quat) -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    (message,) = [m for m in client.due(vehicle, 0) if m.get_msgId() == 282]
    assert list(message.q) == pytest.approx(list(quat_from_euler(0.0, -pi / 2, 0.0)))


def test_a_gimbal_that_is_silent_or_broken_is_named() -> None:
    client = GimbalClient(BRIDGE, MANAGER, DOWN)
    list(client.due(TILTED, 0))
    assert client.problem(SILENT_NS) == ""
    assert "no gimbal has answered for 3 s" in client.problem(SILENT_NS + 1_000 * MS)
    client.on_attitude(attitude_status((1.0, 0.0, 0.0, 0.0), 32, failure=8), 1, TILTED, 5_000 * MS)
    assert client.problem(5_000 * MS) == "the gimbal reports a failure (flags 0x8)"


def test_the_manager_obeys_its_controller_alone() -> None:
    manager = GimbalManager()
    forward = dialect.MAVLink_gimbal_manager_set_attitude_message(
        1, 1, 0, 0, list(q_frd_from_gimbal(-0.1, 0.0)), *[float("nan")] * 3
    )
    for controller, obeys in ((NOBODY, False), (BRIDGE, True)):
        manager.controller = controller
        manager.on_attitude(parsed(191, forward), TILTED)
        manager.move(0)
        manager.move(10_000_000)
        assert (manager.pitch_rad > -1.0) is obeys
    assert not manager.configure((-7.0, 300.0), BRIDGE)
    assert manager.configure((-3.0, -3.0), BRIDGE)
    assert manager.controller == NOBODY


def on_gimbal() -> Rig:
    robot = VehicleConfig(camera=CameraMountConfig(gimbal="mavlink"))
    return Rig(replace(VehicleBridgeConfig(), link="serial:/dev/ttyACM0:921600"), robot)


def test_the_bridge_points_and_publishes_what_the_gimbal_measures() -> None:
    rig = on_gimbal().ready()
    gimbal = MavlinkCodec(1, 154)
    nothing = float("nan")
    rig.autopilot.unasked += gimbal.pack(
        dialect.MAVLink_gimbal_device_attitude_status_message(
            0, 0, 9_999_999, 44, list(q_frd_from_gimbal(-0.9, 0.1)), nothing, nothing, nothing, 0
        )
    )
    rig.autopilot.unasked += gimbal.pack(dialect.MAVLink_heartbeat_message(26, 8, 0x80, 0, 4, 3))
    rig.box.put(CAMERA_PITCH, CameraPitch(t_ns=rig.t_ns, pitch_camera_rad=-0.7))
    before = len(rig.outputs)
    rig.step()
    (measured,) = [o.message for o in rig.outputs[before:] if isinstance(o, Publish) and o.topic is CAMERA_ATTITUDE]
    assert isinstance(measured, CameraAttitude)
    assert (measured.pitch_camera_rad, measured.roll_camera_rad) == pytest.approx((-0.9, 0.1), abs=1e-6)
    assert not rig.status.armed  # the heartbeat of the gimbal isn't the vehicle's


def test_a_gimbal_that_does_not_answer_stands_in_health() -> None:
    rig = on_gimbal().ready()
    rig.run(4.0)
    health = [output for output in rig.outputs if isinstance(output, Health)][-1]
    assert health.state == "degraded"
    assert "no gimbal has answered" in health.text


def test_a_fixed_camera_is_neither_claimed_nor_turned() -> None:
    rig = Rig(replace(VehicleBridgeConfig(), link="serial:/dev/ttyACM0:921600")).ready()
    rig.run(4.0)
    assert CAMERA_PITCH not in rig.bridge.spec.inputs
    assert "gimbal" not in [output for output in rig.outputs if isinstance(output, Health)][-1].text
