"""Aborts, kills and failsafes."""

from math import pi

import pytest

from jezero.base.frames import quat_from_euler
from jezero.base.mavlink import dialect
from jezero.schemas.commands import Abort, Hover, Phase, Release
from jezero.schemas.sensors import Altimeter
from jezero.schemas.topics import ABORT, ALTIMETER, HOVER, RELEASE
from jezero.services.vehicle_bridge.authority import press_down_target
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot
from tests.services.vehicle_bridge.rig import ARM, CRITICAL, MODES, Rig

TARGETS = [("go_to", Phase.GO_TO), ("land_on_spot", Phase.LANDING)]


@pytest.mark.parametrize(("range_m", "z_ned_m"), [(0.99, -2.51), (1.01, -2.0)])
def test_an_abort_below_a_metre_over_ground_or_deck_climbs_to_one_and_a_half(range_m: float, z_ned_m: float) -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.range_m = range_m
    rig.step()
    assert rig.request(ABORT, Abort()).hovering
    assert rig.status.code == 12
    assert rig.autopilot.setpoints[-1].z == pytest.approx(z_ned_m)
    rig.run(0.5)
    assert rig.status.code == (12 if range_m < 1.0 else 3), "the climb is part of the abort"
    rig.range_m = 1.5
    rig.run(0.1)
    assert rig.status.code == 3


@pytest.mark.parametrize(("height_m", "climbs"), [(0.99, True), (1.01, False)])
def test_without_an_altimeter_the_take_off_point_is_the_ground(height_m: float, climbs: bool) -> None:
    rig = Rig()
    rig.autopilot.pos[2] = -0.5
    rig.fly(height_m=3.0)
    rig.go("go_to", Phase.GO_TO)
    rig.autopilot.pos[2] = -0.5 - height_m
    rig.step()
    rig.request(ABORT, Abort())
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-2.0 if climbs else -0.5 - height_m)


@pytest.mark.parametrize("tilt_rad", [(0.6, 0.0), (0.0, 0.6)])
def test_the_altimeter_is_corrected_for_tilt(tilt_rad: tuple[float, float]) -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.range_m = 1.1
    rig.autopilot.q = list(quat_from_euler(*tilt_rad, 0.0))
    rig.step()
    rig.request(ABORT, Abort())
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-2.0 - (1.5 - 1.1 * 0.8253), abs=1e-3)


@pytest.mark.parametrize(("silent_s", "z_ned_m"), [(0.2, -3.0), (0.4, -2.0)])
def test_a_reading_of_the_altimeter_counts_for_three_tenths_of_a_second(silent_s: float, z_ned_m: float) -> None:
    """An older reading is not used: the vehicle is 2 m above the take-off point, which is high enough to hover."""
    rig = Rig().fly(height_m=2.0)
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.range_m = 0.5
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.GO_TO))
    rig.range_m = None
    rig.run(silent_s, lambda: rig.setpoint(control_id, Phase.GO_TO))
    rig.post(ABORT, Abort())
    rig.step()
    assert rig.autopilot.setpoints[-1].z == pytest.approx(z_ned_m)


def test_an_altimeter_that_meets_nothing_leaves_the_height_to_the_take_off_point() -> None:
    rig = Rig().fly(height_m=0.8)
    rig.go("go_to", Phase.GO_TO)
    rig.post(ABORT, Abort())
    rig.run(0.1, lambda: rig.box.put(ALTIMETER, Altimeter(t_ns=rig.t_ns, range_m=None)))
    assert rig.status.code == 12
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-1.5)


def test_a_climb_that_gets_nowhere_ends_after_five_seconds() -> None:
    """The vehicle drifts: one that stands still is wedged."""
    rig = Rig().fly(height_m=0.5)
    rig.go("go_to", Phase.GO_TO)
    rig.autopilot.vel = [0.2, 0.0, 0.0]
    rig.request(ABORT, Abort())
    rig.run(4.9)
    assert rig.status.code == 12
    rig.run(0.2)
    assert rig.status.code == 3


def test_an_abort_on_the_ground_disarms() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    reply = rig.request(ABORT, Abort(reason="wait"))
    assert not reply.hovering
    assert "aborted on request: wait" in reply.reason
    rig.run(0.5)
    assert rig.codes == [0, 1, 12, 0]
    assert not rig.autopilot.armed


def test_an_abort_before_arming_is_known_of_still_disarms() -> None:
    rig = Rig().ready()
    rig.autopilot.reported_armed, rig.autopilot.lost_acks = False, 1
    control_id = rig.acquire().control_id
    rig.autopilot.mode = MODES["OFFBOARD"]
    rig.run_until(lambda: rig.autopilot.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.autopilot.lost_commands = 1
    rig.request(ABORT, Abort())
    rig.run(0.3)
    rig.autopilot.reported_armed = None
    rig.run(1.0)
    assert rig.codes == [0, 1, 12, 0]
    assert not rig.autopilot.armed
    assert (ARM, (0.0, 0.0, 0.0)) in rig.autopilot.commands


def test_a_success_before_the_motors_run_is_none() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert rig.release(control_id).code == 0
    assert rig.codes == [0, 1, 12, 0]
    assert "before the vehicle was armed" in rig.status.text


@pytest.mark.parametrize(("height_m", "rest_m"), [(5.0, 4.25), (1.5, 1.0), (1.05, 1.0)])
def test_a_descent_that_is_aborted_comes_to_rest_above_a_metre(height_m: float, rest_m: float) -> None:
    rig = Rig().fly()
    rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.pos[2], rig.autopilot.vel[2] = -height_m, 1.5
    rig.request(ABORT, Abort())
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-rest_m)


def test_an_abort_at_lift_off_hovers_when_the_autopilot_refuses_to_disarm() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.request(ABORT, Abort())
    rig.autopilot.armed = True
    rig.lift_off(0.3)
    rig.step()
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-1.5)
    rig.autopilot.pos[2] = -1.4
    rig.run(0.2)
    assert rig.status.code == 3


def test_an_abort_of_an_unused_grant_changes_no_code() -> None:
    rig = Rig().fly()
    control_id = rig.acquire("go_to").control_id
    assert rig.request(ABORT, Abort()).hovering
    rig.setpoint(control_id, Phase.GO_TO)
    rig.run(0.2)
    assert rig.codes == [0, 1, 2, 3]


def test_an_abort_without_a_goal_says_so() -> None:
    rig = Rig().ready()
    reply = rig.request(ABORT, Abort())
    assert not reply.hovering
    assert "no goal was in charge" in reply.reason
    assert rig.fly().request(ABORT, Abort()).hovering


def test_an_abort_under_a_pilot_does_not_claim_that_the_bridge_makes_the_vehicle_hover() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(0.1)
    reply = rig.request(ABORT, Abort())
    assert not reply.hovering
    assert reply.reason == "no goal was in charge, the vehicle is under other command"


def test_an_abort_of_a_vehicle_that_is_being_disarmed_does_not_claim_a_hover() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded", then="disarm"))
    rig.step()
    assert rig.status.code == 9
    assert not rig.request(ABORT, Abort()).hovering


def test_a_hover_that_is_requested_before_lift_off_disarms_and_says_that_the_vehicle_does_not_hover() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    reply = rig.request(HOVER, Hover())
    assert not reply.hover_mode
    assert reply.reason == "the goal takeoff ended: hover was requested"
    assert rig.status.code == 0
    assert not rig.autopilot.armed


@pytest.mark.parametrize("request_kind", ["hover", "release"])
def test_a_pilot_who_takes_over_before_the_hover_has_begun_is_named_in_its_reply(request_kind: str) -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    if request_kind == "hover":
        request = rig.post(HOVER, Hover())
    else:
        request = rig.post(RELEASE, Release(control_id=control_id, outcome="succeeded"))
    rig.step()
    assert request not in rig.replies, "the hover begins after a tenth of a second"
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run_until(lambda: request in rig.replies, limit_s=0.2)
    reply = rig.replies[request]
    assert not (reply.hover_mode if request_kind == "hover" else reply.released)
    assert reply.reason == "taken over: the autopilot was switched to POSCTL"


@pytest.mark.parametrize("outcome", ["canceled", "aborted"])
@pytest.mark.parametrize(("action", "phase"), TARGETS)
def test_a_goal_that_ends_early_goes_through_12_to_a_hover(action: str, phase: Phase, outcome: str) -> None:
    rig = Rig().fly()
    control_id = rig.go(action, phase)
    reply = rig.release(control_id, outcome, reason="no reason")
    assert reply.released
    assert reply.code == 3
    assert rig.codes[-2:] == [12, 3]
    assert f"{outcome}: no reason" in rig.status.text


def test_every_code_lasts_long_enough_to_be_seen() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.release(control_id)
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.request(ABORT, Abort())
    rig.run(0.3)
    for code in (2, 5, 12):
        times = [status.t_ns for status in rig.statuses if status.code == code]
        following = next(s.t_ns for s in rig.statuses if s.t_ns > times[-1])
        assert following - times[0] >= 100_000_000


# -- kill and tilt -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seconds", "killed"), [(0.44, False), (0.6, True)])
def test_a_tilt_above_sixty_degrees_for_half_a_second_disarms(seconds: float, killed: bool) -> None:
    rig = Rig().fly()
    rig.autopilot.q = list(quat_from_euler(1.1, 0.0, 0.0))
    rig.run(seconds)
    rig.autopilot.q = [1.0, 0.0, 0.0, 0.0]
    rig.run(0.2)
    assert rig.autopilot.armed != killed
    assert (rig.status.code == 13) == killed


def test_a_large_tilt_in_the_tenth_of_a_second_before_telemetry_stops_cuts_no_motors() -> None:
    rig = Rig().fly()
    rig.autopilot.q = list(quat_from_euler(1.1, 0.0, 0.0))
    rig.run(0.1)
    rig.autopilot.silent = True
    rig.run(3.0)
    rig.autopilot.silent, rig.autopilot.q = False, [1.0, 0.0, 0.0, 0.0]
    rig.run(1.0)
    assert rig.autopilot.armed
    assert rig.status.code == 3


def test_a_vehicle_that_hangs_on_something_and_can_not_climb_is_disarmed() -> None:
    rig = Rig().fly(0.4)
    rig.request(HOVER, Hover(hover_pos=(0.0, 0.0, -3.0)))
    rig.run(5.5)
    assert not rig.autopilot.armed
    assert "motors cut: the vehicle is wedged near the ground, tilted by 0 degrees" in rig.status.text


def test_under_a_pilot_no_tilt_disarms() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["POSCTL"]
    rig.autopilot.q = list(quat_from_euler(1.1, 0.0, 0.0))
    rig.run(2.0)
    assert rig.autopilot.armed


# -- others in charge --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "state", "who"),
    [
        ("LAND", CRITICAL, "failsafe"),
        ("POSCTL", CRITICAL, "failsafe"),
        ("LOITER", 6, "failsafe"),
        ("LAND", 4, "external"),
        ("POSCTL", 4, "external"),
        ("LOITER", 4, "external"),
    ],
)
def test_when_the_autopilot_leaves_offboard_mode_the_goal_ends_and_the_bridge_falls_silent(
    mode: str, state: int, who: str
) -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.autopilot.mode, rig.autopilot.system_status = MODES[mode], state
    rig.step()
    assert (rig.status.code, rig.status.in_charge, rig.status.grant) == (13, who, 0)
    assert rig.status.text.startswith("failsafe: " if who == "failsafe" else "taken over: ")
    assert not rig.status.ready
    rig.autopilot.setpoints.clear()
    rig.autopilot.commands.clear()
    rig.run(2.0, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.autopilot.setpoints == []
    assert rig.autopilot.commands == []
    assert "take control back with hover" in rig.acquire("go_to").reason
    rig.autopilot.landed, rig.autopilot.armed = True, False
    rig.run(0.1)
    assert rig.codes[-2:] == [13, 0]


def test_hover_takes_control_back_from_a_failsafe() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["LAND"]
    rig.run(0.5)
    assert "only while hovering" in rig.request(HOVER, Hover(hover_pos=(0.0, 0.0, -2.0))).reason
    assert rig.request(HOVER, Hover()).hover_mode
    assert rig.autopilot.mode == MODES["OFFBOARD"]
    assert rig.codes[-2:] == [13, 3]
    rig.run(1.0)
    assert rig.status.code == 3


def test_control_is_taken_back_in_the_air_and_with_telemetry_only() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["LAND"]
    rig.step()
    rig.autopilot.silent = True
    rig.run(1.2)
    assert "telemetry" in rig.request(HOVER, Hover()).reason
    rig.autopilot.silent = False
    rig.autopilot.landed = True
    rig.step()
    assert "in the air only" in rig.request(HOVER, Hover()).reason


def test_taking_back_that_fails_leaves_the_vehicle_to_the_failsafe() -> None:
    rig = Rig().fly()
    rig.autopilot.mode = MODES["LAND"]
    rig.step()
    rig.autopilot.lost_commands = 10_000
    reply = rig.request(HOVER, Hover())
    assert not reply.hover_mode
    assert rig.status.code == 13
    rig.autopilot.setpoints.clear()
    rig.run(1.0)
    assert rig.autopilot.setpoints == []


def test_a_bridge_that_starts_with_the_vehicle_armed_sends_nothing_until_asked_to_hover() -> None:
    rig = Rig()
    rig.autopilot.armed, rig.autopilot.mode = True, MODES["OFFBOARD"]
    rig.lift_off()
    rig.run(3.0)
    assert rig.codes == [13]
    assert rig.status.in_charge == "failsafe"
    assert rig.autopilot.setpoints == []
    assert rig.autopilot.commands == []
    assert rig.request(HOVER, Hover()).hover_mode
    assert rig.codes == [13, 3]


def test_a_bridge_that_starts_with_the_vehicle_armed_is_idle_once_the_failsafe_has_landed_it() -> None:
    rig = Rig()
    rig.autopilot.armed, rig.autopilot.mode = True, MODES["LAND"]
    rig.lift_off()
    rig.run(1.0)
    rig.autopilot.armed, rig.autopilot.landed = False, True
    rig.run(1.0)
    assert rig.codes == [13, 0]
    assert rig.acquire().granted


def test_arming_by_somebody_else_is_somebody_elses_flight() -> None:
    rig = Rig().ready()
    rig.autopilot.armed = True
    rig.run(0.1)
    assert (rig.status.code, rig.status.in_charge) == (13, "external")
    assert not rig.acquire().granted


def test_motors_that_stop_in_flight_end_the_goal_in_13() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.autopilot.armed = False
    rig.step()
    assert rig.status.code == 13
    assert "disarmed while the vehicle flies to a point" in rig.status.text


def test_motors_that_stop_while_the_vehicle_climbs_from_its_takeoff_end_it_in_13() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.lift_off()
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.autopilot.armed = False
    rig.step()
    assert (rig.status.code, rig.status.in_charge) == (13, "failsafe")
    assert "disarmed while the vehicle takes off" in rig.status.text


@pytest.mark.parametrize(("code", "doing"), [(4, "flies to a point"), (3, "hovers")])
def test_motors_that_stop_on_the_ground_are_a_failure_unless_the_vehicle_was_to_land(code: int, doing: str) -> None:
    rig = Rig().fly()
    if code == 4:
        rig.go("go_to", Phase.GO_TO)
    rig.autopilot.landed, rig.autopilot.armed = True, False
    rig.run(0.1)
    assert rig.codes[-3:] == [code, 13, 0]
    assert rig.status.text == f"the autopilot disarmed while the vehicle {doing}; landed and disarmed"


@pytest.mark.parametrize("landed", [True, False])
def test_motors_that_stop_at_the_end_of_a_landing_are_its_aim_and_in_the_air_they_are_not(landed: bool) -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.landed, rig.autopilot.armed = landed, False
    rig.autopilot.commands.clear()
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.LANDING))
    assert rig.status.code == (8 if landed else 13)
    assert rig.autopilot.commands == [], "above all, it isn't armed again"
    assert landed or "disarmed while the vehicle lands" in rig.status.text
    assert rig.release(control_id, then="disarm").released is landed
    assert rig.status.code == (0 if landed else 13)


def test_motors_that_stop_in_flight_are_explained_by_the_autopilots_warning() -> None:
    rig = Rig().fly()
    warning = dialect.MAVLink_statustext_message(2, b"Failure detector: attitude")
    rig.autopilot.unasked, rig.autopilot.armed = rig.autopilot.codec.pack(warning), False
    rig.step()
    assert rig.status.text == "the autopilot disarmed while the vehicle hovers (Failure detector: attitude)"


def test_an_auto_disarm_before_lift_off_ends_the_takeoff() -> None:
    rig = Rig().ready()
    control_id = rig.acquire().control_id
    rig.run_until(lambda: rig.status.armed, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.run(0.1, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    rig.autopilot.armed = False
    rig.run(0.3)
    assert rig.codes == [0, 1, 12, 0]


# -- position resets ---------------------------------------------------------------------------------------


def test_a_vehicle_is_pressed_down_with_the_velocity_of_the_platform_and_straight_down_without_one() -> None:
    east = VehicleSnapshot(t_ns=0, timer_ns=0, q_ned_from_frd=quat_from_euler(0.0, 0.0, pi / 2.0))
    landing = Target(None, (0.4, -0.3, 0.2), (1.0, 1.0, 1.0), 0.7)
    assert press_down_target(landing, east) == Target(None, (0.4, -0.3, 0.5), None, 0.7)
    for without in (None, Target((1.0, 2.0, -3.0), None, None, pi / 2.0)):
        pressed = press_down_target(without, east)
        assert pressed.vel_ned_mps == (0.0, 0.0, 0.5)
        assert pressed.yaw_rad == pytest.approx(pi / 2.0)
