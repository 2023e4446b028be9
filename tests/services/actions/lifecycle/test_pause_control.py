"""The pause of a behaviour that knows nothing of pauses, such as one of a package."""

from itertools import pairwise
from math import cos, sin

import pytest

from jezero.base.frames import Vec3, add, distance, norm, scale
from jezero.runtime.service import Spec
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.rows import Action
from jezero.schemas.state import StatusCode
from jezero.services.actions.lifecycle.guard import GuardedPlanner
from jezero.services.actions.lifecycle.pause_control import PauseControl
from jezero.services.actions.motion.behaviour import Behaviour, Done, Move, MovingFrame, Plan, VehicleState
from tests.services.actions.test_behaviours import a_status

MINE = Action("mine", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION)
S = 1_000_000_000
DT_NS = 20_000_000


class Circle:
    """Flies around a point with velocity setpoints, by its own time alone."""

    def __init__(self, frame: MovingFrame | None = None) -> None:
        self.frame = frame
        self.times_ns: list[int] = []

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        self.times_ns.append(t_ns)
        angle_rad, frame = t_ns / S, self.frame or MovingFrame()
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=0.0)
        vel_ned_mps = add((cos(angle_rad), sin(angle_rad), 0.0), frame.vel_ned_mps)
        return Move(Phase.ACTION, feedback, vel_ned_mps=vel_ned_mps, frame=self.frame)

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> None:
        return None


class Flown:
    """A vehicle that follows the setpoints of a pause control exactly."""

    def __init__(self, behaviour: Behaviour) -> None:
        self.behaviour = behaviour
        self.pause = PauseControl(0, 1.0)
        self.t_ns = 0
        self.pos_m: Vec3 = (0.0, 0.0, -3.0)
        self.vel_mps: Vec3 = (0.0, 0.0, 0.0)
        self.moves: list[Move] = []

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * S / DT_NS)):
            self.t_ns += DT_NS
            state = VehicleState(self.pos_m, self.vel_mps, (1.0, 0.0, 0.0, 0.0), armed=True, landed=False)
            move = self.pause.step(self.t_ns, self.behaviour, state)
            assert isinstance(move, Move)
            self.moves.append(move)
            if move.pos_ned_m is not None:
                self.pos_m, self.vel_mps = move.pos_ned_m, move.vel_ned_mps or (0.0, 0.0, 0.0)
            elif move.vel_ned_mps is not None:
                self.vel_mps = move.vel_ned_mps
                self.pos_m = add(self.pos_m, scale(self.vel_mps, DT_NS / S))


def test_it_stops_at_one_point_and_ends_where_it_would_have_ended() -> None:
    plain, paused = Flown(Circle()), Flown(Circle())
    plain.run(4.0)
    paused.run(2.0)
    paused.pause.wanted = True
    paused.run(10.0)
    assert paused.moves[-1].pos_ned_m == paused.moves[-100].pos_ned_m
    assert paused.moves[-1].vel_ned_mps == (0.0, 0.0, 0.0)
    paused.pause.wanted = False
    paused.run((4 * S - (paused.t_ns - paused.pause.behind_ns)) / S + 0.5)
    assert paused.pause.rate == 1.0
    assert paused.t_ns - paused.pause.behind_ns == pytest.approx(4 * S, abs=DT_NS)
    assert distance(paused.pos_m, plain.pos_m) < 0.15  # it comes to rest a little behind its last setpoint


def test_without_a_pause_nothing_changes() -> None:
    circle = Circle()
    flown = Flown(circle)
    flown.run(3.0)
    assert circle.times_ns == list(range(DT_NS, 3 * S + 1, DT_NS))
    assert flown.moves[-1].vel_ned_mps == (cos(3.0), sin(3.0), 0.0)


class North(Circle):
    """Flies north with a constant speed."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=0.0)
        return Move(Phase.ACTION, feedback, vel_ned_mps=(2.0, 0.0, 0.0), acc_ned_mps2=(0.0, 0.0, 0.0))


def test_the_deceleration_of_a_pause_and_the_acceleration_after_it_are_fed_forward() -> None:
    """From 2 m/s with 1 m/s²: two seconds each."""
    flown = Flown(North())
    flown.run(1.0)
    flown.pause.wanted = True
    flown.run(1.0)
    assert flown.moves[-1].vel_ned_mps == pytest.approx((1.0, 0.0, 0.0), abs=0.03)
    assert flown.moves[-1].acc_ned_mps2 == pytest.approx((-1.0, 0.0, 0.0))
    flown.run(2.0)
    flown.pause.wanted = False
    flown.run(1.0)
    assert flown.moves[-1].acc_ned_mps2 == pytest.approx((1.0, 0.0, 0.0))
    flown.run(2.0)
    assert flown.moves[-1].acc_ned_mps2 == pytest.approx((0.0, 0.0, 0.0))


def test_a_frozen_server_brakes_no_more_than_in_one_long_step_and_a_clock_that_goes_back_changes_nothing() -> None:
    """2 m/s at 1 m/s²: half of the speed is left after a second, and no less than 0.9 of it after 5 s in one step."""
    flown = Flown(North())
    flown.run(1.0)
    flown.pause.wanted = True
    flown.t_ns += 5 * S - DT_NS
    flown.run(0.02)
    assert 0.9 < flown.pause.rate < 1.0
    flown.run(0.5)
    rate, behind_ns = flown.pause.rate, flown.pause.behind_ns
    flown.t_ns -= S
    flown.run(0.02)
    assert (flown.pause.rate, flown.pause.behind_ns) == (rate, behind_ns)


class Turns(Circle):
    """Turns on the spot."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=0.0)
        return Move(Phase.ACTION, feedback, vel_ned_mps=(0.0, 0.0, 0.0), yaw_rad=0.0, yaw_rate_rps=0.4)


def test_a_goal_that_stands_is_paused_after_half_a_second_and_its_turn_slows_down_meanwhile() -> None:
    flown = Flown(Turns())
    flown.run(1.0)
    assert flown.moves[-1].yaw_rate_rps == 0.4
    flown.pause.wanted = True
    flown.run(0.26)
    assert flown.moves[-1].yaw_rate_rps == pytest.approx(0.2, abs=0.02)
    assert flown.pause.rate == pytest.approx(0.5, abs=0.05)
    flown.run(0.3)
    assert flown.pause.paused
    assert flown.moves[-1].yaw_rate_rps == 0.0


class Touchdown(Circle):
    """The same, which can't be paused from one of its own times to another."""

    def __init__(self, from_ns: int, until_ns: int) -> None:
        super().__init__()
        self._from_ns, self._until_ns = from_ns, until_ns

    def pause_refusal(self, state: VehicleState) -> str:
        touches = self.times_ns and self._from_ns <= self.times_ns[-1] < self._until_ns
        return "the vehicle touches the ground" if touches else ""


def test_a_pause_that_is_refused_slows_nothing_down_and_begins_once_it_may() -> None:
    plain, refused = Flown(Circle()), Flown(Touchdown(0, 3 * S))
    plain.run(3.0)
    refused.run(1.0)
    refused.pause.wanted = True
    refused.run(2.0)
    assert refused.moves == plain.moves
    assert (refused.pause.rate, refused.pause.behind_ns, refused.pause.paused) == (1.0, 0, False)
    refused.run(3.0)
    assert refused.pause.paused
    assert refused.moves[-1].vel_ned_mps == (0.0, 0.0, 0.0)


def test_a_touchdown_that_begins_while_the_goal_is_being_paused_goes_on_at_full_speed() -> None:
    """At 1 m/s it brakes with 1 m/s²: after 0.2 s it has 0.8 of its speed, and 0.18 s of its own time have passed."""
    flown = Flown(Touchdown(int(1.2 * S), 3 * S))
    flown.run(1.0)
    flown.pause.wanted = True
    flown.run(0.2)
    assert flown.pause.rate == pytest.approx(0.8)
    flown.run(0.06)
    assert flown.pause.rate == 1.0
    assert flown.moves[-1].vel_ned_mps is not None
    assert norm(flown.moves[-1].vel_ned_mps) == pytest.approx(1.0)


def test_in_a_moving_frame_it_hovers_along_with_the_frame() -> None:
    circle = Circle(MovingFrame((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)))
    flown = Flown(circle)
    flown.run(2.0)
    flown.pause.wanted = True
    flown.run(3.0)
    before = flown.moves[-1]
    circle.frame = MovingFrame((0.5, 0.0, 0.0), (0.5, 0.0, 0.0))
    flown.run(0.02)
    after = flown.moves[-1]
    assert before.vel_ned_mps == after.vel_ned_mps == (0.5, 0.0, 0.0)
    assert before.pos_ned_m is not None
    assert after.pos_ned_m == pytest.approx(add(before.pos_ned_m, (0.5, 0.0, 0.0)))


class Follows(Circle):
    """Flies north at 2 m/s in a frame that accelerates to the east at 0.3 m/s², and is at 0.5 m/s there."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        frame = MovingFrame((0.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.3, 0.0))
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=0.0)
        return Move(Phase.ACTION, feedback, vel_ned_mps=(2.0, 0.5, 0.0), acc_ned_mps2=(0.4, 0.3, 0.0), frame=frame)


def test_a_pause_in_a_moving_frame_slows_down_the_flight_and_not_the_frame() -> None:
    """2 m/s in the frame at 1 m/s²: half of the speed after a second, with 0.5² of the path's own acceleration."""
    flown = Flown(Follows())
    flown.run(1.0)
    flown.pause.wanted = True
    flown.run(1.0)
    assert flown.moves[-1].vel_ned_mps == pytest.approx((1.0, 0.5, 0.0), abs=0.03)
    assert flown.moves[-1].acc_ned_mps2 == pytest.approx((0.25 * 0.4 - 1.0, 0.3, 0.0), abs=0.03)
    flown.run(1.1)
    assert flown.pause.paused
    assert flown.moves[-1].vel_ned_mps == pytest.approx((0.0, 0.5, 0.0))
    assert flown.moves[-1].acc_ned_mps2 == pytest.approx((0.0, 0.3, 0.0))


class BrokenHover(Circle):
    """Has a hover of its own, which raises."""

    def plan(self, goal: object, status: object) -> Plan:
        return Plan(lambda t_ns, state: self)

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Move:
        raise ValueError("no hover")


def test_a_hover_of_its_own_that_raises_aborts_the_goal() -> None:
    plan = GuardedPlanner(MINE, BrokenHover(), Spec(name="mine")).plan(None, a_status(StatusCode.HOVER))
    assert isinstance(plan, Plan)
    state = VehicleState((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), armed=True, landed=False)
    behaviour = plan.start(0, state)  # type: ignore[operator]
    pause = PauseControl(0, 1.0)
    pause.wanted = True
    ends = [pause.step(number * DT_NS, behaviour, state) for number in range(100)]
    assert isinstance(ends[-1], Done)
    assert "mine failed in hold: ValueError: no hover" in ends[-1].reason


class HoversItself(North):
    """Has a hover of its own, which climbs."""

    def __init__(self, climb_mps: float = 1.0) -> None:
        super().__init__()
        self.climb_mps = climb_mps
        self.steps_s: list[float] = []

    def hold(self, t_ns: int, dt_s: float, state: VehicleState) -> Move:
        self.steps_s.append(dt_s)
        feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, distance_m=0.0)
        return Move(Phase.ACTION, feedback, vel_ned_mps=(0.0, 0.0, -self.climb_mps))


def test_the_velocity_of_a_hover_of_its_own_decays_when_the_goal_goes_on() -> None:
    flown = Flown(HoversItself())
    flown.run(2.0)
    flown.pause.wanted = True
    flown.run(4.0)
    assert flown.pause.paused
    assert flown.moves[-1].vel_ned_mps == (0.0, 0.0, -1.0)
    flown.pause.wanted = False
    flown.run(2.0)
    climbs_mps = [-move.vel_ned_mps[2] for move in flown.moves[-100:] if move.vel_ned_mps is not None]
    steps_mps = [before - after for before, after in pairwise(climbs_mps)]
    assert climbs_mps[0] == pytest.approx(1.0 - DT_NS / S)
    assert max(steps_mps) <= DT_NS / S + 1e-9, "with 1 m/s², as the goal brakes"
    assert climbs_mps[-1] == 0.0


def test_a_fast_hover_of_its_own_decays_on_after_the_goal_is_at_full_speed_again() -> None:
    """The goal needs two seconds to its 2 m/s, and the climb of 4 m/s four seconds to rest: 1 m/s after three."""
    flown = Flown(HoversItself(climb_mps=4.0))
    flown.run(2.0)
    flown.pause.wanted = True
    flown.run(3.0)
    assert flown.pause.paused
    flown.pause.wanted = False
    flown.run(3.0)
    assert flown.pause.rate == 1.0
    assert flown.moves[-1].vel_ned_mps == pytest.approx((2.0, 0.0, -1.0), abs=0.05)
    flown.run(1.5)
    assert flown.moves[-1].vel_ned_mps == (2.0, 0.0, 0.0)


def test_a_hover_of_its_own_gets_the_time_of_each_step_and_of_a_frozen_server_no_more_than_a_moment() -> None:
    hover = HoversItself()
    flown = Flown(hover)
    flown.pause.wanted = True
    flown.run(3.0)
    assert hover.steps_s[-1] == pytest.approx(DT_NS / S)
    flown.t_ns += 5 * S
    flown.run(0.02)
    assert 0.0 < hover.steps_s[-1] < 0.5


@pytest.mark.parametrize("age_s", [0.0, 0.2])
def test_the_hover_point_is_where_the_vehicle_comes_to_rest(age_s: float) -> None:
    """It follows its setpoint a quarter of a second late, and moves on by the age of its state."""
    pause, north = PauseControl(0, 1.0), North()
    pause.wanted = True
    state = VehicleState((5.0, 0.0, -3.0), (0.4, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, False, age_s)
    t_ns, move = 0, None
    while not pause.paused:
        t_ns += DT_NS
        move = pause.step(t_ns, north, state)
    assert isinstance(move, Move) and move.pos_ned_m is not None
    assert move.pos_ned_m == pytest.approx((5.0 + 0.4 * (0.25 + age_s), 0.0, -3.0))
