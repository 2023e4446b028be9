"""Whole flights in virtual time: the mission, refusals, abort, hover and kill."""

import pytest

from jezero.base.frames import horizontal, norm, subtract
from jezero.schemas import topics
from jezero.schemas.actions import Accepted
from jezero.schemas.commands import Abort, Hover, Kill
from jezero.schemas.goals import LandOnSpotGoal, TakeoffGoal
from jezero.schemas.state import StatusCode as Code
from tests.scenario.rig import Flight, go_to, land_at


def test_the_status_goes_through_the_codes_of_the_thesis() -> None:
    flight = Flight()
    flight.take_off()
    flight.do(topics.GO_TO, go_to(-1.0, -2.0, -3.0))
    result = flight.do(topics.LAND_ON_SPOT, land_at(0.0, 0.0))
    assert result.result is not None and result.result.touchdown_ned_m is not None
    assert flight.codes == [
        Code.IDLE, Code.TAKEOFF, Code.TAKEOFF_DONE, Code.HOVER, Code.GO_TO, Code.GO_TO_DONE, Code.HOVER,
        Code.LANDING, Code.LANDING_DONE, Code.IDLE,
    ]  # fmt: skip
    assert not flight.status.armed and flight.status.landed
    assert flight.truth.contact_force_n > 10.0


def test_go_to_with_takeoff_takes_off_first_without_a_stop() -> None:
    flight = Flight()
    flight.wait_ready()
    flight.do(topics.GO_TO, go_to(0.0, 0.0, -4.0, do_takeoff=True))
    assert flight.codes == [Code.IDLE, Code.TAKEOFF, Code.GO_TO, Code.GO_TO_DONE, Code.HOVER]


def test_go_to_with_takeoff_while_hovering_warns_and_goes_on() -> None:
    flight = Flight()
    flight.take_off()
    request = flight.send(topics.GO_TO, go_to(0.5, 0.0, -2.0, do_takeoff=True))
    accepted = request.replies[0]
    assert isinstance(accepted, Accepted) and accepted.warning
    assert flight.finish(request).outcome == "succeeded"


def test_goals_that_need_a_flying_vehicle_are_refused_on_the_ground() -> None:
    flight = Flight()
    flight.wait_ready()
    assert "takeoff" in flight.refusal(topics.GO_TO, go_to(0.0, 0.0, -4.0))
    assert "on the ground" in flight.refusal(topics.LAND_ON_SPOT, land_at(0.0, 0.0))
    assert not flight.request(topics.HOVER, Hover()).hover_mode
    assert flight.codes == [Code.IDLE]


def test_goals_beyond_a_limit_are_refused_with_the_limit() -> None:
    flight = Flight()
    flight.wait_ready()
    assert "120" in flight.refusal(topics.TAKEOFF, TakeoffGoal(altitude_m=121.0))
    assert flight.refusal(topics.TAKEOFF, TakeoffGoal(altitude_m=-2.0))
    flight.do(topics.TAKEOFF, TakeoffGoal(altitude_m=2.0))
    assert "120" in flight.refusal(topics.GO_TO, go_to(0.0, 0.0, -121.0))
    assert "500" in flight.refusal(topics.GO_TO, go_to(501.0, 0.0, -3.0))
    assert "10" in flight.refusal(topics.GO_TO, go_to(1.0, 0.0, -3.0, speed_mps=11.0))
    assert "−5" in flight.refusal(topics.GO_TO, go_to(1.0, 0.0, 5.0))
    assert "takeoff" in flight.refusal(topics.TAKEOFF, TakeoffGoal(altitude_m=2.0)).lower()
    assert "landing_spot_ned_m" in flight.refusal(topics.LAND_ON_SPOT, LandOnSpotGoal(use_uwb=False, use_tag=False))
    assert not flight.request(topics.HOVER, Hover(hover_pos=(0.0, 0.0, 5.0))).hover_mode
    assert flight.codes[-1] is Code.HOVER


def test_a_second_goal_is_refused_while_one_flies() -> None:
    flight = Flight()
    flight.wait_ready()
    flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=5.0))
    flight.wait_code(Code.TAKEOFF, 1.0)
    assert "TAKEOFF" in flight.refusal(topics.GO_TO, go_to(0.0, 0.0, -4.0)).upper()


def test_an_abort_before_lift_off_disarms() -> None:
    flight = Flight()
    flight.wait_ready()
    request = flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=2.0))
    flight.wait(lambda: flight.status.armed, 5.0, "armed")
    assert flight.status.landed
    assert not flight.request(topics.ABORT, Abort(reason="test")).hovering
    assert flight.finish(request).outcome == "aborted"
    flight.wait_code(Code.IDLE, 5.0)
    assert flight.codes == [Code.IDLE, Code.TAKEOFF, Code.ABORT, Code.IDLE]
    assert not flight.status.armed


def height_m(flight: Flight) -> float:
    return -flight.truth.pos_uav_ned_m[2]


def test_an_abort_close_to_the_ground_climbs_to_one_and_a_half_metres() -> None:
    flight = Flight()
    flight.wait_ready()
    request = flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=5.0))
    flight.wait(lambda: bool(flight.truths) and height_m(flight) > 0.4, 10.0, "lift-off")
    assert flight.request(topics.ABORT, Abort()).hovering
    assert flight.finish(request).outcome == "aborted"
    flight.wait_code(Code.HOVER, 10.0)
    flight.bus.run_for(3.0)
    assert height_m(flight) == pytest.approx(1.5, abs=0.35)
    assert flight.codes == [Code.IDLE, Code.TAKEOFF, Code.ABORT, Code.HOVER]


def test_an_abort_higher_up_hovers_where_it_is() -> None:
    flight = Flight()
    flight.wait_ready()
    request = flight.send(topics.TAKEOFF, TakeoffGoal(altitude_m=6.0))
    flight.wait(lambda: bool(flight.truths) and height_m(flight) > 3.0, 15.0, "3 m")
    flight.request(topics.ABORT, Abort())
    assert flight.finish(request).outcome == "aborted"
    flight.wait_code(Code.HOVER, 5.0)
    flight.bus.run_for(3.0)
    assert 2.8 < height_m(flight) < 4.5


def test_hover_ends_a_goal_and_moves_the_hover_point() -> None:
    flight = Flight()
    flight.take_off()
    request = flight.send(topics.GO_TO, go_to(8.0, 0.0, -3.0))
    flight.wait_code(Code.GO_TO, 2.0)
    flight.bus.run_for(2.0)
    assert flight.request(topics.HOVER, Hover()).hover_mode
    assert flight.finish(request).outcome == "aborted"
    assert flight.request(topics.HOVER, Hover(hover_pos=(0.0, 0.0, -3.0))).hover_mode
    flight.bus.run_for(6.0)
    odometry = flight.status.odometry
    assert odometry is not None
    assert norm(subtract(odometry.pos_uav_ned_m, (0.0, 0.0, -3.0))) < 0.3


def test_kill_needs_to_be_confirmed_and_then_stops_the_motors_in_the_air() -> None:
    flight = Flight()
    flight.take_off()
    assert not flight.request(topics.KILL, Kill()).killed
    unconfirmed = flight.status
    assert unconfirmed.armed
    assert "vehicle=uav1" in flight.request(topics.KILL, Kill(confirm=True)).reason
    assert flight.status.armed
    assert flight.request(topics.KILL, Kill(confirm=True, vehicle="uav1")).killed
    confirmed = flight.status
    assert not confirmed.armed
    flight.bus.run_for(4.0)
    assert flight.codes[-1] is Code.IDLE


def test_a_killed_action_server_leaves_the_vehicle_hovering_within_half_a_second() -> None:
    flight = Flight()
    flight.take_off()
    request = flight.send(topics.GO_TO, go_to(20.0, 0.0, -3.0))
    flight.wait_code(Code.GO_TO, 2.0)
    flight.bus.run_for(2.0)
    flight.bus.remove("go_to")
    flight.wait_code(Code.ABORT, 0.5)
    flight.wait_code(Code.HOVER, 0.2)
    assert request.ended
    flight.bus.run_for(3.0)
    assert norm(flight.truth.vel_uav_ned_mps) < 0.4


def test_a_killed_bridge_lets_the_autopilot_land() -> None:
    flight = Flight()
    flight.take_off()
    flight.bus.remove("vehicle_bridge")
    flight.bus.run_for(12.0)
    assert not flight.truth.armed_motors
    assert norm(flight.truth.vel_uav_ned_mps) < 0.05
    assert horizontal(flight.truth.pos_uav_ned_m) < 2.0
