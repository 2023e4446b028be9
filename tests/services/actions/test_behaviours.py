"""The behaviours against a point mass: they arrive, within their limits, with finite setpoints."""

from itertools import pairwise
from math import dist, hypot, isfinite
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from jezero.base.frames import Quat, Vec3, add, norm, quat_from_euler, scale, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, LandResult, TakeoffGoal
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.topics import GO_TO, LAND_ON_SPOT, TAKEOFF
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion import straight_path
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Preparation, Refusal, VehicleState
from jezero.services.actions.motion.config import MoveConfig
from jezero.services.actions.motion.straight_path import StraightPath, straight_speed_mps
from jezero.services.actions.table import PLANNERS
from jezero.services.actions.takeoff import LEAD_M
from tests.services.actions.fake_bridge import follow

CONFIG = ActionsConfig()
DT_S = 0.02
STILL = (0.0, 0.0, 0.0)


def a_status(code: int) -> Status:
    return Status(t_ns=0, code=code, name="X", armed=False, landed=True, in_charge="none", bridge_boot_id=1, ready=True)


def outcome_of(action: Action[Any], goal: Any, code: int = 3) -> Plan | Refusal:
    """Plan or refusal of a goal, with the vehicle in the state `code`."""
    return PLANNERS[action.name](CONFIG).plan(goal, a_status(code))


def plan_of(action: Action[Any], goal: Any, code: int = 3) -> Plan:
    """Plan of a goal that must not be refused."""
    plan = outcome_of(action, goal, code)
    assert isinstance(plan, Plan), plan
    return plan


def refusal_of(action: Action[Any], goal: Any) -> str:
    """Reason of a goal that must be refused."""
    refusal = outcome_of(action, goal)
    assert isinstance(refusal, Refusal)
    return refusal.reason


class Flight:
    """Flies one goal with a point mass.

    Attributes:
        moves: all setpoints, with the state they were made in.
    """

    def __init__(self, action: Action[Any], goal: Any, state: VehicleState, code: int = 3) -> None:
        self.state = state
        self.t_ns = 5_000_000_000
        self.moves: list[tuple[VehicleState, Move]] = []
        self.done: Done | None = None
        self.rangefinder = True
        self.pushable = True
        self.stands = False
        plan = plan_of(action, goal, code)
        assert not isinstance(plan.start, Preparation)
        self.warning = plan.warning
        self.behaviour = plan.start(self.t_ns, state)
        self._still_s = 0.0

    def run(self, within_s: float) -> Done | None:
        for _ in range(int(within_s / DT_S)):
            self.t_ns += int(DT_S * 1e9)
            move = self.behaviour.step(self.t_ns, self.state)
            if isinstance(move, Done):
                self.done = move
                return move
            self.moves.append((self.state, move))
            self._obey(move)
        return None

    def _obey(self, move: Move) -> None:
        state = self.state
        pos, vel = state.pos_uav_ned_m, state.vel_uav_ned_mps
        if state.armed and self.pushable:
            pos, vel = follow(pos, vel, move.pos_ned_m, move.vel_ned_mps, DT_S)
        self._still_s = self._still_s + DT_S if pos[2] == 0.0 and vel[2] == 0.0 else 0.0
        in_range = self.rangefinder and 0.15 < -pos[2] < 10.0
        self.state = replace(
            state,
            pos_uav_ned_m=pos,
            vel_uav_ned_mps=vel,
            landed=self._still_s > 0.8 or self.stands,
            height_m=-pos[2] if in_range else None,
        )


def standing(armed: bool = True) -> VehicleState:
    return VehicleState((1.0, 2.0, 0.0), STILL, quat_from_euler(0.0, 0.0, 0.3), armed=armed, landed=True)


def hovering(pos: Vec3 = (0.0, 0.0, -3.0), yaw_rad: float = 0.3) -> VehicleState:
    return VehicleState(pos, STILL, quat_from_euler(0.0, 0.0, yaw_rad), armed=True, landed=False, height_m=-pos[2])


def test_a_takeoff_climbs_straight_up_from_where_it_stands() -> None:
    flight = Flight(TAKEOFF, TakeoffGoal(altitude_m=3.0), standing(), code=0)
    done = flight.run(30.0)
    assert done == Done("succeeded", hover_pos_ned_m=(1.0, 2.0, -3.0))
    assert {move.phase for _, move in flight.moves} == {Phase.TAKEOFF}
    assert all(move.pos_ned_m[:2] == (1.0, 2.0) for _, move in flight.moves if move.pos_ned_m)
    assert all(move.yaw_rad == pytest.approx(0.3) for _, move in flight.moves)
    assert max(abs(move.vel_ned_mps[2]) for _, move in flight.moves if move.vel_ned_mps) <= 1.5


@pytest.mark.parametrize("drift_m", [(1.2, 0.0, 0.0), (-0.5, 0.7, 0.4), (0.0, 0.0, -0.8)])
def test_a_takeoff_climbs_from_where_an_estimate_that_settles_late_puts_the_ground(drift_m: Vec3) -> None:
    flight = Flight(TAKEOFF, TakeoffGoal(altitude_m=3.0), standing(), code=0)
    flight.pushable, flight.stands = False, True
    for _ in range(50):
        pos = add(flight.state.pos_uav_ned_m, scale(drift_m, 1.0 / 50))
        flight.state = replace(flight.state, pos_uav_ned_m=pos)
        assert flight.run(DT_S) is None
    ground = flight.state.pos_uav_ned_m
    flight.pushable, flight.stands = True, False
    assert flight.run(15.0) is not None
    assert flight.done is not None and flight.done.outcome == "succeeded"
    sideways, height_m = dist(flight.state.pos_uav_ned_m[:2], ground[:2]), ground[2] - flight.state.pos_uav_ned_m[2]
    assert sideways < 0.35
    assert height_m == pytest.approx(3.0, abs=0.6)
    for state, move in flight.moves:
        assert move.pos_ned_m is not None
        assert dist(state.pos_uav_ned_m[:2], move.pos_ned_m[:2]) < 0.35


def test_a_takeoff_ends_when_the_position_estimate_runs_away_at_the_ground() -> None:
    flight = Flight(TAKEOFF, TakeoffGoal(altitude_m=3.0), standing(), code=0)
    flight.pushable, flight.stands = False, True
    done = None
    while done is None and len(flight.moves) < 2000:
        flight.state = replace(flight.state, pos_uav_ned_m=add(flight.state.pos_uav_ned_m, (0.1, 0.0, 0.0)))
        done = flight.run(DT_S)
    assert done is not None and done.outcome == "aborted"
    assert "the position estimate doesn't settle" in done.reason


def test_a_takeoff_waits_on_the_ground_until_it_is_armed_and_not_for_ever() -> None:
    flight = Flight(TAKEOFF, TakeoffGoal(), standing(armed=False), code=0)
    assert flight.run(5.0) is None
    assert {move.pos_ned_m for _, move in flight.moves} == {(1.0, 2.0, 0.0)}
    flight.state = replace(flight.state, armed=True)
    assert flight.run(30.0) == Done("succeeded", hover_pos_ned_m=(1.0, 2.0, -2.0))
    never = Flight(TAKEOFF, TakeoffGoal(), standing(armed=False), code=0)
    assert never.run(11.0) == Done("aborted", "takeoff: the vehicle was not armed in time")


def test_a_vehicle_that_does_not_rise_is_given_up_with_the_distance() -> None:
    flight = Flight(TAKEOFF, TakeoffGoal(), standing(), code=0)
    flight.pushable = False
    done = flight.run(30.0)
    assert done is not None
    assert done.outcome == "aborted"
    assert "still 2.00 m from the target" in done.reason
    highest = min(move.pos_ned_m[2] for _, move in flight.moves if move.pos_ned_m)
    assert highest == pytest.approx(-LEAD_M, abs=0.05)


def test_go_to_flies_a_straight_line_and_turns_at_a_limited_rate() -> None:
    flight = Flight(GO_TO, GoToGoal(target_ned_m=(-1.0, -2.0, -4.0), yaw_rad=3.0), hovering())
    done = flight.run(30.0)
    assert done == Done("succeeded", hover_pos_ned_m=(-1.0, -2.0, -4.0))
    yaws = [move.yaw_rad for _, move in flight.moves if move.yaw_rad is not None]
    assert yaws[-1] == pytest.approx(3.0)
    turns = [abs(wrap_pi(b - a)) for a, b in pairwise(yaws)]
    assert max(turns) <= CONFIG.move.yaw_rate_rps * DT_S + 1e-9
    for _, move in flight.moves:
        assert move.pos_ned_m is not None
        x, y, _ = move.pos_ned_m
        assert y == pytest.approx(2.0 * x, abs=1e-6)


def test_reached_means_near_and_slow_for_a_second() -> None:
    flight = Flight(GO_TO, GoToGoal(target_ned_m=(3.0, 0.0, -3.0)), hovering())
    flight.run(30.0)
    last_second = [state for state, _ in flight.moves[-50:]]
    assert all(dist(state.pos_uav_ned_m, (3.0, 0.0, -3.0)) < 0.15 for state in last_second)
    assert all(norm(state.vel_uav_ned_mps) < 0.2 for state in last_second)


def test_go_to_takes_off_first_when_asked_to_on_the_ground() -> None:
    flight = Flight(GO_TO, GoToGoal(target_ned_m=(0.0, 0.0, -4.0), do_takeoff=True), standing(), code=0)
    assert flight.warning == ""
    assert flight.run(60.0) == Done("succeeded", hover_pos_ned_m=(0.0, 0.0, -4.0))
    phases = [move.phase for _, move in flight.moves]
    change = phases.index(Phase.GO_TO)
    assert set(phases[:change]) == {Phase.TAKEOFF}
    assert set(phases[change:]) == {Phase.GO_TO}
    assert flight.moves[change][0].pos_uav_ned_m == pytest.approx((1.0, 2.0, -2.0), abs=0.15)


def test_go_to_leaves_the_takeoff_out_when_flying_and_says_so() -> None:
    flight = Flight(GO_TO, GoToGoal(target_ned_m=(0.0, 0.0, -4.0), do_takeoff=True), hovering(), code=3)
    assert "takeoff is left out" in flight.warning
    flight.run(60.0)
    assert {move.phase for _, move in flight.moves} == {Phase.GO_TO}


coordinate = st.floats(-60.0, 60.0)


@pytest.mark.parametrize("depth", [st.floats(-60.0, -10.0), st.floats(-10.0, -0.5)], ids=["up", "down"])
@settings(max_examples=20, deadline=None)
@given(data=st.data(), x=coordinate, y=coordinate, speed_mps=st.floats(0.3, 10.0), yaw_rad=st.floats(-3.1, 3.1))
def test_setpoints_are_finite_and_within_the_speed_limits(
    data: st.DataObject, x: float, y: float, speed_mps: float, yaw_rad: float, depth: st.SearchStrategy[float]
) -> None:
    z = data.draw(depth)
    goal = GoToGoal(target_ned_m=(x, y, z), speed_mps=speed_mps, yaw_rad=yaw_rad)
    flight = Flight(GO_TO, goal, hovering((0.0, 0.0, -10.0)))
    flight.run(400.0)
    assert flight.done == Done("succeeded", hover_pos_ned_m=(x, y, z))
    previous: Vec3 = (0.0, 0.0, -10.0)
    for _, move in flight.moves:
        assert move.pos_ned_m is not None
        assert move.vel_ned_mps is not None
        assert all(isfinite(v) for v in (*move.pos_ned_m, *move.vel_ned_mps))
        assert norm(move.vel_ned_mps) <= speed_mps + 1e-9
        assert -CONFIG.move.speed_up_mps - 1e-9 <= move.vel_ned_mps[2] <= CONFIG.move.speed_down_mps + 1e-9
        assert move.acc_ned_mps2 is not None
        assert norm(move.acc_ned_mps2) <= CONFIG.move.accel_mps2 + 1e-9
        assert dist(previous, move.pos_ned_m) <= speed_mps * DT_S + 1.1e-3
        previous = move.pos_ned_m


def test_the_vertical_limits_slow_a_steep_line() -> None:
    move = MoveConfig()
    assert straight_speed_mps((0.0, 0.0, 0.0), (3.0, 0.0, -4.0), 5.0, move) == pytest.approx(1.5 * 5.0 / 4.0)
    assert straight_speed_mps((0.0, 0.0, -4.0), (3.0, 0.0, 0.0), 5.0, move) == pytest.approx(1.0 * 5.0 / 4.0)
    assert straight_speed_mps((0.0, 0.0, -4.0), (3.0, 0.0, -4.0), 5.0, move) == 5.0
    assert straight_speed_mps((0.0, 0.0, -4.0), (0.0, 0.0, -4.0), 5.0, move) == 5.0


def test_a_frozen_server_goes_on_where_it_was() -> None:
    flight = Flight(GO_TO, GoToGoal(target_ned_m=(50.0, 0.0, -3.0)), hovering())
    flight.run(3.0)
    before = flight.moves[-1][1].pos_ned_m
    flight.t_ns += 5_000_000_000
    flight.run(DT_S)
    after = flight.moves[-1][1].pos_ned_m
    assert before is not None
    assert after is not None
    assert dist(before, after) <= 0.1 * 2.0 + 1e-6


def test_the_reference_waits_for_a_vehicle_that_is_held_back() -> None:
    flight = Flight(GO_TO, GoToGoal(target_ned_m=(50.0, 0.0, -3.0)), hovering())
    flight.pushable = False
    flight.run(10.0)
    last = flight.moves[-1][1].pos_ned_m
    assert last is not None
    assert last[0] == pytest.approx(straight_path.LEAD_M + straight_path.LEAD_S * 2.0, abs=0.1)
    flight.pushable = True
    assert flight.run(60.0) is not None
    assert max(norm(state.vel_uav_ned_mps) for state, _ in flight.moves) < 4.0


def test_a_path_without_length_is_reached_at_once() -> None:
    path = StraightPath(
        0, (1.0, 1.0, -1.0), (1.0, 1.0, -1.0), speed_mps=2.0, lead_max_m=1.0, config=MoveConfig(), yaw_start_rad=0
    )
    state = hovering((1.0, 1.0, -1.0))
    for step in range(60):
        path.step(step * 20_000_000, state)
    assert path.reached
    assert path.vel_ned_mps == STILL


LAND = LandOnSpotGoal(use_uwb=False, use_tag=False, landing_spot_ned_m=(2.0, -1.0, 0.0))


@pytest.mark.parametrize("rangefinder", [True, False])
def test_a_landing_approaches_descends_slows_down_and_disarms(rangefinder: bool) -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((0.0, 0.0, -5.0)))
    flight.rangefinder = rangefinder
    assert flight.run(60.0) == Done("succeeded", then="disarm")
    phases = [move.feedback.phase for _, move in flight.moves]
    assert list(dict.fromkeys(phases)) == ["approach", "descent", "contact"]
    assert {move.phase for _, move in flight.moves} == {Phase.LANDING}
    x, y, _ = flight.state.pos_uav_ned_m
    assert hypot(x - 2.0, y + 1.0) < 0.15
    for state, move in flight.moves:
        down = move.vel_ned_mps[2] if move.vel_ned_mps else 0.0
        if move.feedback.phase == "descent":
            assert down <= 0.7
            assert down == 0.3 or -state.pos_uav_ned_m[2] >= 1.5
        if move.feedback.phase == "contact":
            assert move.vel_ned_mps == (0.0, 0.0, 0.5)
            assert -state.pos_uav_ned_m[2] < 0.2
    result = flight.behaviour.result(True, (2.0, -1.0, 0.0))
    assert result == LandResult(completed=True, touchdown_ned_m=(2.0, -1.0, 0.0))


def test_a_landing_from_low_climbs_before_it_approaches() -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((0.0, 0.0, -0.6)))
    assert flight.run(60.0) == Done("succeeded", then="disarm")
    for state, move in flight.moves:
        if move.pos_ned_m is not None and state.pos_uav_ned_m[2] > -1.3:
            assert move.pos_ned_m[:2] == (0.0, 0.0)


def test_a_landing_whose_touchdown_nobody_confirms_is_given_up() -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((2.0, -1.0, -2.0)))
    while not (flight.moves and flight.moves[-1][1].feedback.phase == "contact"):
        assert flight.run(DT_S) is None
    for _ in range(2000):
        flight.state = replace(flight.state, landed=False)
        flight.run(DT_S)
        if flight.done is not None:
            break
    assert flight.done is not None
    assert flight.done.outcome == "aborted"
    assert "doesn't detect the ground" in flight.done.reason


def descend(flight: Flight, to_phase: str) -> None:
    while not (flight.moves and flight.moves[-1][1].feedback.phase == to_phase):
        assert flight.run(DT_S) is None


NOSE_UP, TO_THE_RIGHT = quat_from_euler(0.0, 0.25, 0.0), quat_from_euler(0.25, 0.0, 0.0)


@pytest.mark.parametrize("tilted", [NOSE_UP, TO_THE_RIGHT])
def test_a_landing_that_tilts_over_something_climbs_and_is_given_up(tilted: Quat) -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((2.0, -1.0, -2.0)))
    while flight.state.pos_uav_ned_m[2] < 0.0:
        assert flight.run(DT_S) is None
    flight.state = replace(flight.state, q_ned_from_frd=tilted)
    before = len(flight.moves)
    done = flight.run(10.0)
    assert done is not None
    assert (done.outcome, done.then) == ("aborted", "hover")
    assert done.reason == "the vehicle tilted over an edge or a rock at the landing spot: land somewhere else"
    climbs = [move for _, move in flight.moves[before:] if move.vel_ned_mps == (0.0, 0.0, -1.0)]
    assert len(climbs) == pytest.approx(1.5 / DT_S, abs=2)
    assert flight.state.pos_uav_ned_m[2] < -1.0


def test_a_tilt_against_the_wind_is_no_edge() -> None:
    flight = Flight(LAND_ON_SPOT, LAND, replace(hovering((2.0, -1.0, -2.0)), q_ned_from_frd=NOSE_UP))
    descend(flight, "contact")
    assert flight.run(10.0) == Done("succeeded", then="disarm")


def test_a_tilt_in_the_air_is_no_edge() -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((2.0, -1.0, -4.0)))
    descend(flight, "descent")
    flight.run(0.5)
    flight.state = replace(flight.state, q_ned_from_frd=NOSE_UP)
    assert flight.run(1.0) is None
    downs = [move.vel_ned_mps[2] for _, move in flight.moves if move.vel_ned_mps and move.pos_ned_m is None]
    assert min(downs) > 0.0


def test_a_vehicle_that_lies_on_its_side_has_not_landed() -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((2.0, -1.0, -2.0)))
    descend(flight, "contact")
    flight.state = replace(flight.state, landed=True, q_ned_from_frd=(0.6, 0.8, 0.0, 0.0))
    done = flight.behaviour.step(flight.t_ns + int(DT_S * 1e9), flight.state)
    assert done == Done("aborted", "the vehicle fell over: it is tilted by 106 degrees", "disarm")


def test_a_vehicle_that_falls_after_a_false_contact_descends_again() -> None:
    flight = Flight(LAND_ON_SPOT, LAND, hovering((2.0, -1.0, -4.0)))
    while not (flight.moves and flight.moves[-1][1].feedback.phase == "descent"):
        flight.run(DT_S)
    flight.pushable = False
    flight.state = replace(flight.state, vel_uav_ned_mps=STILL)
    flight.run(2.0)
    assert flight.moves[-1][1].feedback.phase == "contact"
    flight.pushable = True
    assert flight.run(60.0) == Done("succeeded", then="disarm")
    assert norm(flight.moves[-100][0].vel_uav_ned_mps) < 0.61
