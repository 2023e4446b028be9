"""A flight by velocity against a point mass: limits, loss of the commands, walls and ground."""

from itertools import pairwise
from math import hypot, pi

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.base.frames import Vec3, distance, norm, quat_from_euler, subtract
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.fence import Fence, Zone
from jezero.schemas.goals import FlyVelocityGoal, VelocityResult
from jezero.schemas.state import Status
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.fly_velocity.behaviour import FlyVelocityPlanner
from jezero.services.actions.motion.behaviour import Done, Move, Plan, Preparation, Refusal, VehicleState
from tests.services.actions.fake_bridge import follow

CONFIG = ActionsConfig()
DT_S, START_NS = 0.02, 5_000_000_000
FIELD = Zone(name="field", corners_ned_m=((-20.0, -20.0), (12.0, -20.0), (12.0, 8.0), (-20.0, 8.0)))
CRATER = Zone(name="crater", corners_ned_m=((4.0, -2.0), (8.0, -2.0), (8.0, 2.0), (4.0, 2.0)))
FORWARD = VelocityCommand(t_ns=0, goal_id="g", forward_mps=2.0)
LAST = VelocityCommand(t_ns=0, goal_id="g", is_last=True)


def plan_of(goal: FlyVelocityGoal) -> Plan | Refusal:
    status = Status(
        t_ns=0, code=3, name="HOVER", armed=True, landed=False, in_charge="hover", bridge_boot_id=1, ready=True
    )
    return FlyVelocityPlanner(CONFIG).plan(goal, status)


class Flight:
    """A point mass that flies by velocity, 3 m up.

    Attributes:
        moves: all setpoints.
        ground_m: height of the ground that the altimeter measures.
    """

    def __init__(self, yaw_rad: float = 0.0, fence: Fence | None = None, speed_max_mps: float | None = None) -> None:
        q_ned_from_frd = quat_from_euler(0.0, 0.0, yaw_rad)
        self.state = VehicleState((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), q_ned_from_frd, True, False, fence=fence)
        self.t_ns = START_NS
        self.moves: list[Move] = []
        self.ground_m = 0.0
        self.stuck = False
        plan = plan_of(FlyVelocityGoal(speed_max_mps=speed_max_mps))
        assert isinstance(plan, Plan) and not isinstance(plan.start, Preparation)
        self.behaviour = plan.start(self.t_ns, self.state)

    @property
    def speeds_mps(self) -> list[float]:
        return [norm(move.vel_ned_mps) for move in self.moves if move.vel_ned_mps is not None]

    @property
    def pos_ned_m(self) -> Vec3:
        return self.state.pos_uav_ned_m

    def run(self, for_s: float, command: VelocityCommand | None = None) -> Done | None:
        """Fly, with a new command in each step; None sends none."""
        for _ in range(round(for_s / DT_S)):
            self.t_ns += int(DT_S * 1e9)
            pos, vel = self.state.pos_uav_ned_m, self.state.vel_uav_ned_mps
            height_m = -pos[2] - self.ground_m + CONFIG.vehicle.height_altimeter_m
            self.state = msgspec.structs.replace(self.state, height_m=height_m)
            if command is not None:
                newest = msgspec.structs.replace(command, t_ns=self.t_ns)
                self.state = msgspec.structs.replace(self.state, velocity_command=newest)
            move = self.behaviour.step(self.t_ns, self.state)
            if isinstance(move, Done):
                return move
            self.moves.append(move)
            if not self.stuck:
                pos, vel = follow(pos, vel, move.pos_ned_m, move.vel_ned_mps, DT_S)
            self.state = msgspec.structs.replace(self.state, pos_uav_ned_m=pos, vel_uav_ned_mps=vel)
        return None


@pytest.mark.parametrize(
    ("yaw_rad", "command", "way"),
    [
        (0.0, FORWARD, (1.0, 0.0, 0.0)),
        (pi / 2, FORWARD, (0.0, 1.0, 0.0)),
        (0.0, VelocityCommand(t_ns=0, goal_id="g", right_mps=1.0), (0.0, 1.0, 0.0)),
        (pi / 2, VelocityCommand(t_ns=0, goal_id="g", right_mps=1.0), (-1.0, 0.0, 0.0)),
        (0.3, VelocityCommand(t_ns=0, goal_id="g", up_mps=1.0), (0.0, 0.0, -1.0)),
    ],
)
def test_a_command_leads_along_the_axes_of_the_heading(yaw_rad: float, command: VelocityCommand, way: Vec3) -> None:
    flight = Flight(yaw_rad)
    flight.run(5.0, command)
    moved = subtract(flight.pos_ned_m, (0.0, 0.0, -3.0))
    assert distance(moved, tuple(norm(moved) * each for each in way)) < 0.01  # type: ignore[arg-type]
    assert norm(moved) > 2.0


def test_a_turn_is_clockwise_for_a_positive_rate_and_turns_the_way_too() -> None:
    flight = Flight()
    flight.run(6.0, VelocityCommand(t_ns=0, goal_id="g", forward_mps=1.0, yaw_rate_rps=0.5))
    yaw_rad = flight.moves[-1].yaw_rad
    assert yaw_rad is not None and yaw_rad == pytest.approx(0.5 * 6.0 - 0.5 * 0.5**2 / 1.5, abs=0.02)  # ramp of 1/3 s
    assert flight.pos_ned_m[1] > 0.5  # to the east: on a circle to the right


def test_speeds_yaw_rate_and_accelerations_are_limited() -> None:
    flight = Flight(speed_max_mps=1.5)
    wild = VelocityCommand(t_ns=0, goal_id="g", forward_mps=40.0, right_mps=-30.0, up_mps=50.0, yaw_rate_rps=9.0)
    flight.run(4.0, wild)
    flight.run(4.0, VelocityCommand(t_ns=0, goal_id="g", forward_mps=-40.0, up_mps=-50.0))
    vels = [move.vel_ned_mps for move in flight.moves if move.vel_ned_mps]
    assert max(hypot(n, e) for n, e, _ in vels) == pytest.approx(1.5)
    assert min(d for *_, d in vels) == pytest.approx(-1.5)
    assert max(d for *_, d in vels) == pytest.approx(1.0)
    assert max(abs(move.yaw_rate_rps or 0.0) for move in flight.moves) == pytest.approx(0.8)
    for before, after in pairwise(vels):
        change_n, change_e, change_d = subtract(after, before)
        assert hypot(change_n, change_e) <= 1.0 * DT_S + 1e-9
        assert abs(change_d) <= 1.0 * DT_S + 1e-9


def test_without_commands_the_vehicle_stops_smoothly_and_the_goal_goes_on() -> None:
    flight = Flight()
    flight.run(5.0, FORWARD)
    assert flight.run(5.0) is None
    assert flight.speeds_mps[-1] == 0.0
    stopped = flight.pos_ned_m
    # The last command counts for half a second: 2 m/s, 1 m; then 2 s of braking, 2 m; and the lag of the point mass.
    assert stopped[0] == pytest.approx(8.0 + 1.0 + 2.0, abs=0.3)
    assert flight.run(2.0) is None
    assert distance(flight.pos_ned_m, stopped) < 0.02
    assert [flight.moves[index].feedback.follows for index in (0, -1)] == [True, False]
    flight.run(2.0, FORWARD)
    assert flight.pos_ned_m[0] > stopped[0] + 1.0


def test_after_a_long_silence_the_goal_ends_with_the_reason() -> None:
    flight = Flight()
    flight.run(2.0, FORWARD)
    assert flight.run(9.9) is None
    done = flight.run(0.3)
    assert done is not None and done.outcome == "aborted" and "no velocity command for 10 s" in done.reason
    assert done.hover_pos_ned_m is not None and distance(done.hover_pos_ned_m, flight.pos_ned_m) < 0.05


def test_the_last_command_ends_the_goal_at_rest() -> None:
    flight = Flight()
    flight.run(4.0, FORWARD)
    done = flight.run(5.0, LAST)
    assert done is not None and done.outcome == "succeeded"
    assert flight.speeds_mps[-1] < 0.05
    assert flight.behaviour.result(True, flight.pos_ned_m) == VelocityResult(
        completed=True, pos_uav_ned_m=flight.pos_ned_m
    )


@pytest.mark.parametrize("speed_mps", [0.5, 2.0, 3.0])
def test_it_stops_a_metre_in_front_of_the_fence_and_says_so(speed_mps: float) -> None:
    flight = Flight(fence=Fence(name="mars", keep_in=FIELD), yaw_rad=pi / 2)
    flight.run(25.0, VelocityCommand(t_ns=0, goal_id="g", forward_mps=speed_mps))
    assert flight.pos_ned_m[1] == pytest.approx(7.0, abs=0.02)
    assert max(flight.state.pos_uav_ned_m[1], *(m.pos_ned_m[1] for m in flight.moves if m.pos_ned_m)) < 7.02
    assert flight.moves[-1].feedback.limited_by == "the area 'field' to stay in"
    flight.run(3.0, VelocityCommand(t_ns=0, goal_id="g", forward_mps=-speed_mps))
    assert flight.moves[-1].feedback.limited_by == ""
    assert flight.pos_ned_m[1] < 6.6


def test_it_slides_along_a_wall_and_stops_in_front_of_a_zone_and_under_the_ceiling() -> None:
    flight = Flight(fence=Fence(keep_in=FIELD, keep_out=(CRATER,), ceiling_m=6.0))
    flight.run(15.0, FORWARD)
    assert flight.pos_ned_m[0] == pytest.approx(3.0, abs=0.02)
    flight.run(10.0, VelocityCommand(t_ns=0, goal_id="g", forward_mps=1.0, right_mps=1.0))
    assert flight.pos_ned_m[1] == pytest.approx(7.0, abs=0.1)
    assert flight.pos_ned_m[0] > 3.5
    flight.run(10.0, VelocityCommand(t_ns=0, goal_id="g", up_mps=1.0))
    assert flight.pos_ned_m[2] == pytest.approx(-5.0, abs=0.02)
    assert "ceiling" in flight.moves[-1].feedback.limited_by


def test_it_stays_above_the_least_height_and_above_ground_that_is_higher() -> None:
    down = VelocityCommand(t_ns=0, goal_id="g", up_mps=-1.0)
    flight = Flight()
    flight.run(10.0, down)
    assert -flight.pos_ned_m[2] == pytest.approx(0.7, abs=0.02)  # over ground at the world's origin
    assert flight.moves[-1].feedback.limited_by == "the ground, over which 0.7 m are kept"
    flight.ground_m = 1.5
    flight.run(6.0, down)
    assert -flight.pos_ned_m[2] == pytest.approx(2.2, abs=0.05)
    flight.ground_m = -10.0  # a valley: the least height of every goal counts from the world's origin
    flight.run(10.0, down)
    assert -flight.pos_ned_m[2] == pytest.approx(0.5, abs=0.02)
    assert flight.moves[-1].feedback.limited_by == "the least height of 0.5 m"


def test_a_floor_of_the_fence_is_kept_too() -> None:
    flight = Flight(fence=Fence(keep_in=FIELD, floor_over_ground_m=2.0))
    flight.run(8.0, VelocityCommand(t_ns=0, goal_id="g", up_mps=-1.0))
    assert -flight.pos_ned_m[2] == pytest.approx(2.0, abs=0.02)


def test_the_reference_waits_for_a_vehicle_that_does_not_come_along() -> None:
    flight = Flight()
    flight.stuck = True
    flight.run(10.0, FORWARD)
    assert flight.moves[-1].pos_ned_m is not None
    assert flight.moves[-1].pos_ned_m[0] <= 1.0 + 0.5 * 3.0


def test_a_command_from_before_a_pause_is_not_followed_after_it() -> None:
    flight = Flight()
    flight.run(2.0, FORWARD)
    old = msgspec.structs.replace(FORWARD, t_ns=flight.t_ns - 3_000_000_000)  # the pause lasted three seconds
    flight.state = msgspec.structs.replace(flight.state, velocity_command=old)
    flight.run(0.1)
    assert not flight.moves[-1].feedback.follows


@pytest.mark.parametrize("speed_mps", [0.0, -1.0, 11.0, float("nan")])
def test_a_speed_beyond_the_vehicles_limits_is_refused(speed_mps: float) -> None:
    plan = plan_of(FlyVelocityGoal(speed_max_mps=speed_mps))
    assert isinstance(plan, Refusal) and "is not within 0.1 to 10 m/s" in plan.reason


numbers = st.floats(-50.0, 50.0)


@settings(max_examples=40)
@given(st.lists(st.tuples(numbers, numbers, numbers, st.floats(-10.0, 10.0)), min_size=1, max_size=8))
def test_no_commands_lead_out_of_the_fence(commands: list[tuple[float, float, float, float]]) -> None:
    flight = Flight(fence=Fence(keep_in=FIELD, keep_out=(CRATER,), ceiling_m=10.0), speed_max_mps=6.0)
    for forward, right, up, turn in commands:
        command = VelocityCommand(
            t_ns=0, goal_id="g", forward_mps=forward, right_mps=right, up_mps=up, yaw_rate_rps=turn
        )
        flight.run(2.5, command)
    for move in flight.moves:
        assert move.pos_ned_m is not None
        north, east, down = move.pos_ned_m
        assert -19.1 <= north <= 11.1 and -19.1 <= east <= 7.1 and -9.1 <= down <= -0.4
        assert not (3.1 < north < 8.9 and -1.9 < east < 1.9)
