"""What health and status say of the vehicle that is not ready, of its link and of its fence."""

import pytest
from msgspec.structs import replace

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.service import Health
from jezero.schemas.commands import Phase
from jezero.schemas.fence import Fence, SetFence, Zone
from jezero.schemas.topics import SET_FENCE
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from tests.services.vehicle_bridge.rig import MODES, Rig

FIELD = Zone(name="field", corners_ned_m=((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)))


def health_of(rig: Rig) -> Health:
    """The last health."""
    return [output for output in rig.outputs if isinstance(output, Health)][-1]


def lose(rig: Rig, *message_ids: int) -> Rig:
    """Let the messages of these kinds get lost on their way from the autopilot to the bridge."""
    telemetry, codec = rig.autopilot.telemetry, MavlinkCodec(255, 1)

    def without() -> bytes:
        messages = codec.parse(telemetry())
        return b"".join(bytes(m.get_msgbuf()) for m in messages if m.get_msgId() not in message_ids)

    rig.autopilot.telemetry = without  # type: ignore[method-assign]
    return rig


@pytest.mark.parametrize(
    ("message_id", "reason"),
    [
        (dialect.MAVLINK_MSG_ID_ODOMETRY, "the autopilot sends no odometry yet: its estimator is still converging"),
        (dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, "the autopilot has no origin yet: it waits for GNSS"),
        (dialect.MAVLINK_MSG_ID_HEARTBEAT, "the autopilot has not reported yet whether it is armed"),
    ],
)
def test_a_vehicle_is_not_ready_until_each_part_of_its_telemetry_has_come(message_id: int, reason: str) -> None:
    rig = lose(Rig(), message_id)
    rig.run(2.0)
    assert not rig.status.ready
    assert rig.status.not_ready_reason == reason
    assert health_of(rig).state in ("starting", "degraded")
    assert reason in rig.acquire().reason


def test_no_parameter_is_set_until_the_autopilot_has_reported_that_it_is_disarmed() -> None:
    config = VehicleBridgeConfig(parameters={"MPC_XY_VEL_P_ACC": 4.0})
    unknown, disarmed = lose(Rig(config), dialect.MAVLINK_MSG_ID_HEARTBEAT), Rig(config)
    for rig in (unknown, disarmed):
        rig.autopilot.parameters = {"MPC_XY_VEL_P_ACC": 1.8}
        rig.run(1.0)
    assert unknown.autopilot.set_parameters == []
    assert disarmed.autopilot.set_parameters != []


def test_an_idle_vehicle_whose_telemetry_is_missing_for_more_than_a_second_is_not_ready() -> None:
    rig = Rig().ready()
    rig.autopilot.silent = True
    rig.run(0.9)
    assert rig.status.ready
    rig.run(2.2)
    assert rig.status.not_ready_reason == "the autopilot's telemetry has been missing for 3 s"
    assert (health_of(rig).state, health_of(rig).text) == ("degraded", rig.status.not_ready_reason)
    rig.autopilot.silent = False
    rig.run(0.2)
    assert rig.status.ready
    assert health_of(rig).state == "ok"


def test_arming_checks_that_do_not_pass_are_named_with_the_mode_and_the_autopilots_warning() -> None:
    rig = Rig().ready()
    rig.autopilot.armable = False
    rig.run(0.2)
    checks = "the autopilot's arming checks don't pass yet in mode AUTO.LOITER"
    assert rig.status.not_ready_reason == checks
    warning = dialect.MAVLink_statustext_message(3, b"Preflight Fail: Compass")
    rig.autopilot.unasked = rig.autopilot.codec.pack(warning)
    rig.run(0.2)
    assert rig.status.not_ready_reason == f"{checks}: Preflight Fail: Compass"


def test_the_vehicle_of_a_pilot_is_not_ready_for_goals_with_the_reason() -> None:
    rig = Rig().fly()
    assert (rig.status.ready, rig.status.not_ready_reason) == (True, "")
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(0.2)
    assert not rig.status.ready
    taken_over = "taken over: the autopilot was switched to POSCTL"
    assert rig.status.not_ready_reason == f"not under the bridge's command: {taken_over}"


@pytest.mark.parametrize(("armed", "landed"), [(False, True), (True, False)])
def test_until_the_land_detector_is_known_a_disarmed_vehicle_alone_has_landed(armed: bool, landed: bool) -> None:
    rig = lose(Rig(), dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
    rig.autopilot.armed = armed
    rig.run(0.5)
    assert rig.status.armed is armed
    assert rig.status.landed is landed


def test_health_is_published_when_it_has_changed_and_says_what_the_vehicle_does() -> None:
    rig = Rig().fly()
    assert (health_of(rig).state, health_of(rig).text) == ("ok", "the vehicle hovers; the autopilot is linked")
    rig.outputs.clear()
    rig.run(2.0)
    assert not [output for output in rig.outputs if isinstance(output, Health)]
    rig.go("go_to", Phase.GO_TO)
    assert health_of(rig).text == "the vehicle flies to a point; the autopilot is linked"


def test_malformed_messages_of_the_link_are_counted_in_health() -> None:
    rig = Rig().ready()
    assert "malformed" not in health_of(rig).text
    broken = bytearray(rig.autopilot.codec.pack(dialect.MAVLink_extended_sys_state_message(0, 2)))
    broken[-1] ^= 0xFF
    rig.autopilot.unasked = bytes(broken)
    rig.run(0.2)
    assert "; 1 malformed MAVLink messages" in health_of(rig).text
    assert rig.status.landed, "what such a message says counts for nothing"


def test_a_vehicle_outside_its_fence_degrades_health_until_it_is_back() -> None:
    rig = Rig(replace(VehicleBridgeConfig(), on_fence="stop")).ready()
    assert rig.request(SET_FENCE, SetFence(fence=Fence(keep_in=FIELD))).accepted
    rig.fly()
    assert health_of(rig).state == "ok"
    rig.autopilot.pos[0] = 10.6
    rig.run(0.2)
    assert health_of(rig).state == "degraded"
    assert "; the vehicle is outside the fence" in health_of(rig).text
    rig.autopilot.pos[0] = 5.0
    rig.run(0.2)
    assert health_of(rig).state == "ok"
