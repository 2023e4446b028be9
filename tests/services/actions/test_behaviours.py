"""The behaviours against a point mass: they arrive, within their limits, with finite setpoints."""

from itertools import pairwise
from math import dist, isfinite
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from jezero.base.frames import Vec3, add, norm, quat_from_euler, scale, wrap_pi
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, TakeoffGoal
from jezero.schemas.rows import Action
from jezero.schemas.state import Status
from jezero.schemas.topics import GO_TO, TAKEOFF
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
@settings(max_examples=20)
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
