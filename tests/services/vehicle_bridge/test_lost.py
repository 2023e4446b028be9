"""Position resets, lost links, restarts, and vehicle time that jumps."""

import pytest

from jezero.base.mavlink import dialect
from jezero.base.vehicle_config import VehicleConfig, VehicleLimitsConfig
from jezero.runtime.service import Subscribe
from jezero.schemas.commands import Abort, Acquire, Hover, Phase, Release
from jezero.schemas.topics import ABORT, ACQUIRE, ALTIMETER, HOVER, RELEASE
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from tests.services.vehicle_bridge.rig import BOOT_ID, MODES, Rig

TARGETS = [("go_to", Phase.GO_TO), ("land_on_spot", Phase.LANDING)]


def test_a_position_reset_moves_the_hover_point_along() -> None:
    rig = Rig().fly()
    rig.autopilot.pos[0] += 1.5
    rig.autopilot.reset_counter += 1
    rig.step()
    rig.run(0.1)
    assert rig.autopilot.setpoints[-1].x == pytest.approx(1.5)
    assert rig.odometry[-1].reset_counter == 1
    assert rig.odometry[-1].reset_offset_ned_m == pytest.approx((1.5, 0.0, 0.0))


def test_a_position_reset_brings_no_hover_point_to_a_vehicle_that_the_wind_has_pushed_off_it() -> None:
    rig = Rig().fly()
    rig.autopilot.pos[:2] = [0.4, -0.3]
    rig.run(0.1)
    rig.autopilot.pos[:2] = [1.9, -2.3]
    rig.autopilot.reset_counter += 1
    rig.step()
    rig.run(0.1)
    assert (rig.autopilot.setpoints[-1].x, rig.autopilot.setpoints[-1].y) == pytest.approx((1.5, -2.0))


def test_a_hover_point_that_a_position_reset_moves_beyond_the_limits_is_given_up_for_where_the_vehicle_is() -> None:
    rig = Rig().fly()
    rig.request(HOVER, Hover(hover_pos=(0.0, 0.0, -100.0)))
    rig.autopilot.pos[2] -= 50.0
    z_m = rig.autopilot.pos[2]
    rig.autopilot.reset_counter += 1
    rig.step()
    rig.run(0.1)
    assert rig.autopilot.setpoints[-1].z == pytest.approx(z_m, abs=0.1)
    assert "beyond the limits" in rig.status.text


def test_a_setpoint_computed_before_a_reset_is_moved_and_one_after_it_is_not() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.autopilot.pos[1] -= 0.7
    rig.autopilot.reset_counter = 1
    rig.step()
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(3.0, 0.0, -2.0), reset_counter=0)
    rig.step()
    assert rig.autopilot.setpoints[-1].y == pytest.approx(-0.7)
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(3.0, -0.7, -2.0), reset_counter=1)
    rig.step()
    assert rig.autopilot.setpoints[-1].y == pytest.approx(-0.7)
    reply = rig.release(control_id, hover_pos_ned_m=(3.0, 0.0, -2.0), reset_counter=0)
    assert reply.released
    assert rig.autopilot.setpoints[-1].y == pytest.approx(-0.7)


def test_a_position_reset_of_a_vehicle_that_stands_moves_its_take_off_point_alone() -> None:
    rig = Rig().ready()
    rig.autopilot.pos[1] += 2.0
    rig.autopilot.reset_counter += 1
    rig.run(0.2)
    assert rig.codes == [0] and rig.autopilot.setpoints == []
    rig.fly()
    assert rig.status.takeoff_ned_m == (0.0, 2.0, 0.0)


def test_a_position_reset_of_a_vehicle_that_flew_before_the_bridge_started_is_survived() -> None:
    rig = Rig()
    rig.autopilot.armed, rig.autopilot.mode = True, MODES["OFFBOARD"]
    rig.lift_off()
    rig.run(0.5)
    rig.autopilot.pos[0] += 3.0
    rig.autopilot.reset_counter += 1
    rig.run(0.2)
    assert rig.status.takeoff_ned_m is None
    assert rig.odometry[-1].reset_offset_ned_m == pytest.approx((3.0, 0.0, 0.0))


def test_a_climb_after_an_abort_goes_on_where_a_position_reset_moves_the_vehicle_beyond_the_limits() -> None:
    rig = Rig().fly(height_m=0.5)
    rig.go("go_to", Phase.GO_TO)
    rig.post(ABORT, Abort())
    rig.step()
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-1.5)
    rig.autopilot.pos[0] += 600.0
    rig.autopilot.reset_counter += 1
    rig.run(0.1)
    assert rig.status.code == 12
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-1.5)


def test_the_height_over_the_take_off_point_survives_a_vertical_reset() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.autopilot.pos[2] -= 1.2
    rig.autopilot.reset_counter = 1
    rig.step()
    rig.autopilot.pos[2] = -1.2 - 0.9
    rig.step()
    rig.request(ABORT, Abort())
    assert rig.autopilot.setpoints[-1].z == pytest.approx(-1.2 - 1.5)


# -- lost links and restarts -------------------------------------------------------------------------------


def test_a_silent_autopilot_ends_the_goal_then_the_hover() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.autopilot.silent = True
    rig.run(1.3, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.codes[-3:] == [4, 12, 3]
    assert "no telemetry" in rig.status.text
    assert not rig.status.ready
    rig.run(4.0)
    assert rig.codes[-2:] == [3, 13]
    rig.autopilot.setpoints.clear()
    rig.run(1.0)
    assert rig.autopilot.setpoints == []


def test_odometry_that_stops_beside_heartbeats_that_go_on_ends_the_goal_after_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    armed = 1 | dialect.MAV_MODE_FLAG_SAFETY_ARMED
    heartbeat = dialect.MAVLink_heartbeat_message(2, 12, armed, MODES["OFFBOARD"], dialect.MAV_STATE_ACTIVE, 3)
    monkeypatch.setattr(rig.autopilot, "telemetry", lambda: rig.autopilot.codec.pack(heartbeat))
    rig.run(0.9, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.status.code == 4
    rig.run(0.4, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.codes[-3:] == [4, 12, 3]
    assert "no telemetry" in rig.status.text


def test_telemetry_that_comes_back_in_time_leaves_the_hover() -> None:
    rig = Rig().fly()
    rig.autopilot.silent = True
    rig.run(3.0)
    rig.autopilot.silent = False
    rig.run(5.0)
    assert rig.codes == [0, 1, 2, 3]
    assert rig.status.ready


@pytest.mark.parametrize(("seconds", "lands"), [(29.0, False), (30.5, True)])
def test_without_its_router_for_thirty_seconds_the_bridge_lands(seconds: float, lands: bool) -> None:
    rig = Rig().fly()
    rig.box.connected = False
    rig.run(seconds)
    assert (rig.autopilot.mode == MODES["LAND"]) == lands
    assert rig.status.code == (13 if lands else 3)
    assert not lands or "router" in rig.status.text


def test_the_time_without_a_router_counts_from_its_last_sign_of_life() -> None:
    rig = Rig(VehicleBridgeConfig(router_timeout_s=1.0))
    rig.box.wall_ns = 86_400_000_000_000
    rig.fly()
    rig.run(1.5)
    for connected, seconds in ((False, 0.9), (True, 0.1), (False, 0.9), (True, 0.1), (False, 0.9)):
        rig.box.connected = connected
        rig.run(seconds)
    assert rig.status.code == 3
    rig.run(0.2)
    assert rig.status.code == 13
    assert rig.autopilot.mode == MODES["LAND"]


def test_a_pilot_who_takes_over_before_the_command_to_land_has_arrived_keeps_control() -> None:
    rig = Rig().fly()
    rig.box.connected = False
    rig.autopilot.lost_commands = 1
    rig.run_until(lambda: rig.status.code == 13, limit_s=31.0)
    rig.autopilot.mode = MODES["POSCTL"]
    rig.run(5.0)
    assert rig.autopilot.mode == MODES["POSCTL"]
    assert (rig.status.in_charge, rig.status.text) == ("external", "somebody switched the autopilot to POSCTL")


def test_a_lost_command_to_land_is_sent_again() -> None:
    rig = Rig().fly()
    rig.box.connected = False
    rig.autopilot.lost_commands = 1
    rig.run(32.0)
    assert rig.autopilot.mode == MODES["LAND"]
    assert (rig.status.in_charge, rig.status.text[:9]) == ("failsafe", "landing: ")


def test_on_the_ground_a_lost_router_changes_nothing() -> None:
    rig = Rig().ready()
    rig.box.connected = False
    rig.run(31.0)
    assert rig.codes == [0]
    assert rig.autopilot.commands == []


def test_a_new_epoch_ends_the_goal_and_resets_the_vehicle() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.epoch_id += 1
    rig.autopilot.silent = True
    rig.run(0.32, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.status.code == 13
    assert rig.status.text == "the vehicle was respawned"
    assert rig.status.odometry is None
    assert rig.status.epoch_id == rig.epoch_id
    rig.autopilot.silent, rig.autopilot.armed, rig.autopilot.landed = False, False, True
    rig.autopilot.pos[:] = [0.0, 0.0, 0.0]
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO))
    assert rig.codes[-2:] == [13, 0]
    rig.ready()
    assert rig.odometry[-1].reset_offset_ned_m == (0.0, 0.0, 0.0)
    assert rig.acquire(goal_id="g2").granted


def test_an_idle_vehicle_that_is_respawned_stays_idle_and_takes_goals_again() -> None:
    rig = Rig().ready()
    waiting = rig.acquire(goal_id="waiting")
    rig.epoch_id += 1
    rig.step()
    assert rig.status.text == "the vehicle was respawned"
    assert (rig.status.grant, rig.status.in_charge) == (0, "none")
    assert rig.release(waiting.control_id).reason == "the vehicle was respawned"
    assert rig.ready().acquire(goal_id="next").granted
    assert rig.codes == [0]


def test_an_abort_that_comes_with_a_new_epoch_is_stamped_with_the_new_vehicles_time() -> None:
    rig = Rig().fly()
    rig.autopilot.armed, rig.autopilot.landed = False, True
    rig.autopilot.pos[:] = [0.0, 0.0, 0.0]
    rig.epoch_id, rig.t_ns = rig.epoch_id + 1, 100_000_000
    rig.post(ABORT, Abort())
    rig.step()
    assert rig.status.epoch_id == rig.epoch_id
    assert rig.status.t_ns == rig.t_ns
    rig.ready()
    goal = Acquire(goal_id="g2", action="takeoff", goal_t_ns=rig.t_ns)
    assert rig.request(ACQUIRE, goal).granted, "the goal came after the abort"


def test_an_autopilot_whose_time_goes_back_has_restarted() -> None:
    rig = Rig().fly()
    rig.autopilot.armed, rig.autopilot.landed = False, True
    rig.t_ns = 100_000_000
    rig.run(0.2)
    assert rig.codes[-2:] == [13, 0]
    assert any(status.text == "the autopilot restarted" for status in rig.statuses)


def test_without_vehicle_time_or_autopilot_the_status_says_what_is_missing() -> None:
    rig = Rig()
    for wall_ns in range(0, 1_600_000_000, 20_000_000):
        assert not rig.statuses or wall_ns >= 1_500_000_000, "an idle status before telemetry arrived"
        rig.box.wall_ns = wall_ns
        for output in rig.bridge.step(0, rig.box):
            rig._apply(output)
    assert rig.status.not_ready_reason.startswith("no vehicle time yet")
    rig.autopilot.silent = True
    rig.run(0.2)
    assert rig.status.not_ready_reason == "no telemetry from the autopilot yet"
    assert rig.status.bridge_boot_id == BOOT_ID
    assert "no telemetry from the autopilot yet" in rig.request(ACQUIRE, Acquire(goal_id="g", action="takeoff")).reason
    assert "no telemetry from the autopilot yet" in rig.request(HOVER, Hover()).reason


def test_vehicle_time_that_steps_back_interrupts_neither_stream_nor_time_outs() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.stand_still(0.28)
    rig.autopilot.setpoints.clear()
    rig.run(1.2)
    assert rig.codes[-2:] == [12, 3]
    assert len(rig.autopilot.setpoints) >= 12
    assert not rig.release(control_id).released


def test_garbage_on_the_link_changes_nothing() -> None:
    rig = Rig().fly()
    rig._to_bridge = bytes(range(256)) * 4
    rig.autopilot.pos[0] = float("nan")
    rig.run(0.2)
    rig.autopilot.pos[0] = 0.0
    rig.run(0.5)
    assert rig.codes == [0, 1, 2, 3]
    assert all(s.x == 0.0 for s in rig.autopilot.setpoints)


def test_the_altimeter_is_subscribed_while_armed_only() -> None:
    rig = Rig().fly()
    control_id = rig.go("land_on_spot", Phase.LANDING)
    rig.autopilot.landed = True
    rig.request(RELEASE, Release(control_id=control_id, outcome="succeeded", then="disarm"))
    rig.run(0.2)
    assert [o.topics for o in rig.outputs if isinstance(o, Subscribe)] == [(ALTIMETER,), ()]


def test_the_altimeter_is_subscribed_before_the_motors_run() -> None:
    rig = Rig().ready()
    rig.autopilot.refuse_arming = "not yet"
    control_id = rig.acquire().control_id
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.TAKEOFF))
    assert not rig.status.armed
    assert [o.topics for o in rig.outputs if isinstance(o, Subscribe)] == [(ALTIMETER,)]


def test_the_limits_are_the_vehicles() -> None:
    rig = Rig(robot=VehicleConfig(limits=VehicleLimitsConfig(altitude_max_m=10.0))).fly()
    assert "limit of 10 m" in rig.request(HOVER, Hover(hover_pos=(0.0, 0.0, -11.0))).reason


def test_vehicle_time_that_stood_still_costs_a_goal_nothing() -> None:
    """Until the master says so it seems to go on, and then the same time passes once more."""
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    for _ in range(10):
        rig.setpoint(control_id, Phase.GO_TO)
        rig.run(0.16)
        rig.stand_still(0.14)
        rig.run(0.12)
    assert rig.status.code == 4


def test_after_vehicle_time_stood_still_a_vehicle_without_setpoints_hovers_within_half_a_second() -> None:
    rig = Rig().fly()
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.stand_still(0.28)
    rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=None, vel_ned_mps=(1.0, 0.0, 0.0))
    rig.run(0.1)
    assert rig.autopilot.setpoints[-1].vx == 1.0
    rig.run(0.38)
    assert rig.autopilot.setpoints[-1].vx != 1.0
