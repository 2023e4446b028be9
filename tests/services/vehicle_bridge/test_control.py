"""Goals in control, their end, and hover requests."""

import re

import msgspec
import pytest

from jezero.base.codec import decode, encode
from jezero.base.config import load_config
from jezero.runtime.service import Health
from jezero.schemas.commands import Abort, Hover, Kill, Phase, Release
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ABORT, HOVER, KILL, RELEASE
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from tests.services.vehicle_bridge.rig import ARM, MODES, SET_MODE, Rig


def test_a_takeoff_goes_through_0_1_2_3_and_engages_before_it_arms() -> None:
    rig = Rig().fly()
    assert rig.codes == [0, 1, 2, 3]
    assert [c for c in rig.autopilot.commands if c[1][0] == 1.0] == [
        (SET_MODE, (1.0, 6.0, 0.0)),
        (ARM, (1.0, 0.0, 0.0)),
    ]
    assert rig.status.in_charge == "hover"
    assert rig.status.grant == 0


def test_a_go_to_that_takes_off_first_goes_through_0_1_4_5_3() -> None:
    rig = Rig().ready()
    control_id = rig.acquire("go_to", do_takeoff=True).control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.lift_off()
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.GO_TO))
    rig.setpoint(control_id, Phase.TAKEOFF)
    rig.step()
    assert rig.status.code == 4
    assert rig.release(control_id).code == 3
    assert rig.codes == [0, 1, 4, 5, 3]


def test_a_landing_goes_through_8_9_0_and_presses_down_until_disarmed() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.pos[2] = 0.0
    request = rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then="disarm"))
    rig.run(0.7)
    assert rig.status.code == 9
    assert rig.autopilot.setpoints[-1].vz == pytest.approx(0.5)
    assert request not in rig.replies
    assert rig.request(HOVER, Hover()).reason == "the vehicle stands on the ground and is being disarmed"
    rig.autopilot.landed = True
    rig.run_until(lambda: request in rig.replies, limit_s=1.0)
    assert rig.replies[request].released
    assert rig.replies[request].code == 0
    assert rig.codes == [0, 1, 2, 3, 8, 9, 0]


def test_the_status_says_whether_a_goal_has_begun_or_begins_with_a_takeoff() -> None:
    rig = Rig().fly()
    assert "the goal takeoff has begun" in [status.text for status in rig.statuses]
    rig = Rig().ready()
    control_id = rig.acquire("go_to", do_takeoff=True).control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.status.text == "the goal go to begins with a takeoff"
    rig.lift_off()
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.status.text == "the goal go to has begun"
    rig.release(control_id)
    rig.go("return_home", Phase.LANDING)
    assert rig.status.text == "the goal return home has begun"


def test_a_pause_is_in_the_status_from_its_first_setpoint_to_its_last() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.statuses.clear()
    rig.setpoint(control_id, Phase.GO_TO, paused=True)
    rig.step()
    assert (rig.status.paused, rig.status.text) == (True, "the goal go to is paused")
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, paused=True))
    rig.statuses.clear()
    rig.setpoint(control_id, Phase.GO_TO)
    rig.step()
    assert (rig.status.paused, rig.status.text) == (False, "the goal go to goes on")
    rig.setpoint(control_id, Phase.GO_TO, paused=True)
    rig.step()
    rig.request(ABORT, Abort())
    assert not rig.status.paused


def test_nobody_is_in_charge_of_an_idle_vehicle() -> None:
    assert Rig().ready().status.in_charge == "none"


def test_each_request_to_hover_abort_or_kill_counts_once_in_the_status() -> None:
    rig = Rig().fly()
    assert rig.status.interventions == 0
    assert "below the limit" in rig.request(HOVER, Hover(hover_pos=(0.0, 0.0, -0.1))).reason
    assert not rig.request(KILL, Kill()).killed
    assert rig.status.interventions == 0, "what was refused has changed nothing"
    rig.request(HOVER, Hover())
    rig.step()
    assert rig.status.interventions == 1
    rig.request(ABORT, Abort())
    rig.step()
    assert rig.status.interventions == 2
    rig.request(KILL, Kill(confirm=True, vehicle="uav1"))
    rig.step()
    assert rig.status.interventions == 3


def forced(rig: Rig) -> list[tuple[int, tuple[float, float, float]]]:
    return [command for command in rig.autopilot.commands if command[1][1] == 21196.0]


def test_a_landing_that_is_sure_of_the_ground_is_disarmed_by_force() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    reply = rig.release(control_id, then="force_disarm")
    assert reply.released and reply.code == 0
    assert len(forced(rig)) == 1
    assert not rig.status.armed
    assert rig.codes == [0, 1, 2, 3, 8, 9, 0]
    assert "by force" in next(status.text for status in rig.statuses if status.code == 9)


def test_a_vehicle_that_the_autopilot_detects_as_landed_is_disarmed_without_force() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.landed = True
    assert rig.release(control_id, then="force_disarm").code == 0
    assert not forced(rig)


def test_nothing_is_disarmed_by_force_above_a_tenth_of_a_metre_by_the_altimeter() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.range_m = 0.21
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.LANDING))
    reply = rig.release(control_id, then="force_disarm")
    assert not reply.released
    assert "the altimeter measures 0.21 m" in reply.reason
    rig.run(0.5)
    rig.range_m = 1.6
    rig.run(1.0)
    assert not forced(rig)
    assert rig.codes[-2:] == [12, 3]
    assert rig.status.armed


def test_force_ends_where_the_altimeter_begins_to_measure() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.lost_commands = 1
    rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then="force_disarm"))
    rig.run(0.1)
    rig.range_m = 0.5
    rig.run(3.0)
    assert not forced(rig)
    assert rig.status.armed


def test_nothing_but_a_landing_is_disarmed_by_force() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    reply = rig.release(control_id, then="force_disarm")
    assert not reply.released
    assert "nothing else does" in reply.reason
    rig.run(1.0)
    assert not forced(rig)


@pytest.mark.parametrize("outcome", ["aborted", "canceled"])
def test_a_landing_that_failed_is_not_disarmed_by_force(outcome: str) -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.release(control_id, outcome, then="force_disarm")
    rig.run(1.0)
    assert not forced(rig)
    assert rig.status.code == 3


def test_in_0_nothing_is_streamed_and_the_autopilot_is_left_ready_to_arm_again() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.landed = True
    assert rig.release(control_id, then="disarm").code == 0
    rig.run(0.1)
    rig.autopilot.setpoints.clear()
    rig.run(1.0)
    assert rig.autopilot.setpoints == []
    assert rig.autopilot.mode == MODES["LOITER"]


def test_a_landing_that_the_autopilot_does_not_disarm_is_left_to_its_failsafe() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    request = rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then="disarm"))
    rig.run_until(lambda: request in rig.replies)
    assert not rig.replies[request].released
    assert rig.replies[request].code == 13
    assert "denied" in rig.status.text
    assert rig.status.in_charge == "failsafe"


def test_an_action_of_a_package_flies_in_14_and_15_with_its_name_in_the_status() -> None:
    rig = Rig().fly()
    control_id = rig.acquire("somersault").control_id
    rig.run_until(lambda: rig.status.code == StatusCode.ACTION, each=lambda: rig.setpoint(control_id, Phase.ACTION))
    assert (rig.status.code, rig.status.action, rig.status.in_charge) == (14, "somersault", "goal")
    rig.release(control_id, "succeeded")
    rig.run(0.5)
    assert rig.codes[-4:] == [3, 14, 15, 3]
    assert rig.status.action == ""


def test_a_grant_lapses_without_a_setpoint_within_half_a_second() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run(0.44)
    assert rig.status.grant == 1
    rig.run(0.14)
    assert rig.status.grant == 0
    rig.setpoint(control_id, Phase.TAKEOFF)
    rig.run(0.5)
    assert rig.codes == [0]
    assert rig.autopilot.setpoints == []


def test_when_the_owner_has_vanished_the_goal_ends_and_the_vehicle_hovers_within_half_a_second() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    silent_since_ns = rig.t_ns
    rig.box.departed = ("go_to",)
    rig.run_until(lambda: rig.status.code == 3, limit_s=1.0)
    assert rig.t_ns - silent_since_ns <= 500_000_000
    assert rig.codes[-3:] == [4, 12, 3]
    assert "ended: it sent no setpoint for" in rig.status.text


def test_when_the_owner_falls_silent_the_vehicle_hovers_within_half_a_second_and_goes_on_with_it() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.autopilot.vel[0] = 2.0
    rig.box.departed = ("get_images",)
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=None, vel_ned_mps=(2.0, 0.0, 0.0)))
    assert rig.autopilot.setpoints[-1].vx == 2.0
    rig.run(0.5)
    assert rig.autopilot.setpoints[-1].vx != 2.0
    assert rig.autopilot.setpoints[-1].x == pytest.approx(1.0)  # the vehicle comes to rest there
    assert (rig.status.code, rig.status.in_charge) == (4, "goal")
    assert re.search(r"hovering until the goal go to goes on: it sent no setpoint for 0\.3\d s", rig.status.text)
    rig.run(0.4)
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=None, vel_ned_mps=(2.0, 0.0, 0.0))
    rig.step()
    assert rig.autopilot.setpoints[-1].vx == 2.0
    rig.run(0.3)
    assert (rig.codes[-1], rig.status.text[-7:]) == (4, "goes on")


def test_an_owner_that_stays_silent_loses_control_after_a_second() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    silent_since_ns = rig.t_ns
    rig.run_until(lambda: rig.status.code == 12, limit_s=2.0)
    assert 1_000_000_000 <= rig.t_ns - silent_since_ns <= 1_050_000_000
    rig.run(0.2)
    assert rig.codes[-3:] == [4, 12, 3]
    assert "ended: it sent no setpoint for 1.0" in rig.status.text


def test_a_vehicle_whose_goal_is_late_is_not_armed() -> None:
    rig = Rig().ready()
    rig.autopilot.refuse_arming = "Arming denied: not yet"
    control_id = rig.acquire().control_id
    rig.run(0.3, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.run(0.4)
    rig.autopilot.refuse_arming = ""
    rig.run(0.4)
    assert "hovering until the goal takeoff" in rig.status.text and not rig.status.armed
    rig.run_until(lambda: bool(rig.status.armed), lambda: rig.setpoint(control_id, Phase.TAKEOFF), limit_s=3.0)


def test_arming_that_is_refused_ends_the_goal_with_the_autopilots_words() -> None:
    rig = Rig().ready()
    rig.autopilot.refuse_arming = "Arming denied: compass not calibrated"
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.code == 12, lambda: rig.setpoint(control_id, Phase.TAKEOFF), limit_s=6.0)
    assert "compass not calibrated" in rig.status.text
    assert rig.status.grant == 0
    rig.run(1.0)
    assert rig.codes == [0, 1, 12, 0]
    assert rig.autopilot.setpoints[-1].time_boot_ms < rig.t_ns // 1_000_000 - 800


@pytest.mark.parametrize("fault", ["lost_commands", "lost_acks"])
def test_lost_commands_and_lost_acknowledgements_are_made_up_for(fault: str) -> None:
    rig = Rig().ready()
    setattr(rig.autopilot, fault, 2)
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF), limit_s=4.0)
    assert rig.codes == [0, 1]


def test_a_release_is_answered_again_when_it_is_repeated() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    assert rig.release(control_id).released
    again = rig.release(control_id)
    assert again.released
    assert again.code == 3


def test_a_release_of_control_that_was_taken_away_says_why() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.request(ABORT, Abort(reason="enough"))
    reply = rig.release(control_id)
    assert not reply.released
    assert "aborted on request: enough" in reply.reason
    assert "never given" in rig.release("b0-77").reason


def test_a_landing_cannot_succeed_in_the_air_and_a_go_to_cannot_disarm() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    request = rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then="disarm"))
    rig.step()
    assert not rig.replies[request].released
    assert rig.status.code == 4


def test_the_hover_after_a_goal_is_where_the_release_says() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.release(control_id, hover_pos_ned_m=(1.0, 2.0, -3.0))
    rig.run(0.2)
    last = rig.autopilot.setpoints[-1]
    assert (last.x, last.y, last.z) == pytest.approx((1.0, 2.0, -3.0))


def test_hover_at_a_point_is_for_3_only_and_within_the_limits() -> None:
    rig = Rig()
    assert "take off first" in rig.ready().request(HOVER, Hover()).reason
    rig.fly()
    assert rig.request(HOVER, Hover(hover_pos=(1.0, 1.0, -5.0))).hover_mode
    rig.run(0.1)
    assert rig.autopilot.setpoints[-1].z == -5.0
    assert "5 m up is −5" in rig.request(HOVER, Hover(hover_pos=(1.0, 1.0, 5.0))).reason
    assert "0.3 m up, below the limit of 0.5 m" in rig.request(HOVER, Hover(hover_pos=(1.0, 1.0, -0.3))).reason
    assert "limit of 120 m" in rig.request(HOVER, Hover(hover_pos=(1.0, 1.0, -121.0))).reason
    assert "limit of 500 m" in rig.request(HOVER, Hover(hover_pos=(400.0, 400.0, -5.0))).reason
    assert "hover_req is false" in rig.request(HOVER, Hover(hover_req=False)).reason
    assert rig.autopilot.setpoints[-1].z == -5.0
    rig.go("go_to", Phase.GO_TO)
    assert "only while hovering" in rig.request(HOVER, Hover(hover_pos=(1.0, 1.0, -5.0))).reason


def test_hover_during_a_goal_ends_the_goal_and_hovers_where_the_vehicle_comes_to_rest() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.autopilot.pos[:] = [4.0, 0.0, -3.0]
    rig.autopilot.vel[:] = [2.0, 0.0, 0.0]
    assert rig.request(HOVER, Hover()).hover_mode
    assert rig.codes[-3:] == [4, 12, 3]
    assert rig.autopilot.setpoints[-1].x == pytest.approx(5.0)
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-3.0)


def test_the_settings_that_ship_are_the_defaults() -> None:
    shipped = load_config(VehicleBridgeConfig, "vehicle_bridge")
    assert msgspec.structs.replace(shipped, parameters={}) == VehicleBridgeConfig()


def test_no_message_that_others_read_has_the_control_id() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run(0.2)
    assert rig.status.grant > 0
    assert control_id not in encode(rig.status).decode()


def test_the_place_of_the_takeoff_is_in_the_status_while_the_vehicle_is_armed() -> None:
    assert Rig().ready().status.takeoff_ned_m is None
    rig = Rig().ready()
    rig.autopilot.pos = [3.0, 4.0, -1.0]
    rig.fly()
    assert rig.status.takeoff_ned_m == (3.0, 4.0, -1.0), "where it stood with its motors off"
    rig.autopilot.pos = [9.0, 4.0, -5.0]
    rig.run(0.2)
    assert rig.status.takeoff_ned_m == (3.0, 4.0, -1.0)


def test_a_vehicle_that_is_carried_along_while_its_motors_run_took_off_where_they_were_started() -> None:
    rig = Rig().ready()
    control_id = rig.acquire("takeoff").control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.autopilot.pos = [5.0, 0.0, 0.0]
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.status.takeoff_ned_m == (0.0, 0.0, 0.0)


def test_a_bridge_is_starting_until_the_first_telemetry_and_degraded_when_that_ends() -> None:
    rig, states = Rig(), []
    for seconds, silent in ((0.5, True), (5.0, False), (3.0, True)):
        rig.autopilot.silent = silent
        rig.run(seconds)
        states.append([output.state for output in rig.outputs if isinstance(output, Health)][-1])
    assert states == ["starting", "ok", "degraded"]


def test_the_health_of_an_idle_bridge_says_why_the_vehicle_is_not_ready() -> None:
    rig = Rig().ready()
    rig.autopilot.armable = False
    rig.run(2.0)
    (health,) = [output for output in rig.outputs if isinstance(output, Health)][-1:]
    assert (health.state, health.text) == ("degraded", rig.status.not_ready_reason) and health.text


def test_a_flying_vehicle_has_no_reason_not_to_take_off_until_its_telemetry_fails() -> None:
    rig = Rig().fly()
    rig.autopilot.armable = False
    rig.run(0.5)
    assert rig.status.not_ready_reason == ""
    rig.autopilot.silent = True
    rig.run(1.5)
    assert rig.status.not_ready_reason


def test_a_reason_as_long_as_a_message_may_have_is_shortened_where_the_reply_has_more_words() -> None:
    rig = Rig().ready().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    reply = rig.request(ABORT, Abort(reason="x" * 2000))
    assert decode(type(reply), encode(reply)).hovering
    released = rig.release(control_id)
    assert decode(type(released), encode(released)) == released
