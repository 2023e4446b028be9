"""What ends a flight, whatever the action: numbers and motions by hand, then goals of every action."""

from collections.abc import Callable, Sequence
from itertools import accumulate
from math import radians, sin

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3, distance, quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.node import Mailbox
from jezero.schemas import topics
from jezero.schemas.actions import Result
from jezero.schemas.commands import Phase
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.goals import Goal, GoToGoal, MoveFeedback
from jezero.schemas.state import Odometry, StatusCode
from jezero.services.actions.lifecycle.protection import (
    FlightProtection,
    GroundProximity,
    ResetWatch,
    RunawayDetector,
    fence_refusal,
)
from jezero.services.actions.motion.behaviour import Move, MovingFrame, Plan, VehicleState
from tests.services.actions.fake_camera import FakeCamera
from tests.services.actions.lifecycle.test_server_plans import CIRCLE, FIELD, SPOT
from tests.services.actions.rig import World
from tests.services.actions.test_behaviours import a_status

# -- the fence, before the flight --

FIELD_M = Zone(name="field", corners_ned_m=((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)))
FENCE_OF_FIELD = Fence(keep_in=FIELD_M, floor_over_ground_m=2.0)


def fence_of(way_ned_m: Sequence[Vec3], plan: Plan, of_status: str = "f", of_fence: str | None = "f") -> str:
    """Refusal of a way by the ids of the fence in the status and in its own message; None: there is no message."""
    inbox = Mailbox(())
    inbox.add_message(topics.STATUS.name, replace(a_status(StatusCode.HOVER), fence_id=of_status))
    if of_fence is not None:
        inbox.add_message(topics.FENCE.name, FenceState(t_ns=0, fence=FENCE_OF_FIELD, fence_id=of_fence))
    return fence_refusal(way_ned_m, plan, inbox)


PLAN = Plan(lambda t_ns, state: None)  # type: ignore[arg-type, return-value]
LEVEL_WAY: tuple[Vec3, ...] = ((0.0, 0.0, -3.0), (9.0, 0.0, -3.0))


@pytest.mark.parametrize(
    ("way_ned_m", "plan", "leaves"),
    [
        (LEVEL_WAY, PLAN, False),
        (((0.0, 0.0, -3.0), (15.0, 0.0, -3.0)), PLAN, True),
        (((0.0, 0.0, 0.0), (0.0, 0.0, -3.0)), PLAN, True),  # it is below the floor
        (((0.0, 0.0, 0.0), (0.0, 0.0, -3.0)), replace(PLAN, do_takeoff=True), False),
        (((0.0, 0.0, -3.0), (5.0, 0.0, 0.0)), PLAN, True),
        (((0.0, 0.0, -3.0), (5.0, 0.0, 0.0)), replace(PLAN, lands=True), False),
        ((), PLAN, False),  # an unknown way
    ],
)
def test_a_way_that_leaves_the_fence_is_refused_but_may_begin_and_end_on_the_ground(
    way_ned_m: Sequence[Vec3], plan: Plan, leaves: bool
) -> None:
    refusal = fence_of(way_ned_m, plan)
    assert bool(refusal) is leaves
    assert isinstance(refusal, str) and ("'fence'" in refusal) is leaves


@pytest.mark.parametrize("of_fence", [None, "", "old"])
def test_no_goal_starts_while_the_fence_that_the_bridge_holds_is_not_known(of_fence: str | None) -> None:
    refusal = fence_of(LEVEL_WAY, PLAN, "f", of_fence)
    assert refusal == "the vehicle's fence is not known yet: send the goal again in a second"
    assert fence_of(((0.0, 0.0, -3.0), (50.0, 0.0, -3.0)), PLAN, "", of_fence) == "", "there is none any more"


# -- steps of the autopilot's estimate --

MOVE = Move(Phase.GO_TO, None, pos_ned_m=(0.0, 0.0, -3.0))
START = Odometry(
    t_ns=0,
    epoch_id=1,
    pos_uav_ned_m=(0.0, 0.0, -3.0),
    vel_uav_ned_mps=(0.0, 0.0, 0.0),
    q_ned_from_frd=quat_from_euler(0.0, 0.0, radians(170.0)),
    rates_uav_frd_rps=(0.0, 0.0, 0.0),
)


def after(yaw_deg: float = 170.0, offset_ned_m: Vec3 = (0.0, 0.0, 0.0), resets: int = 1) -> Odometry:
    attitude = quat_from_euler(0.0, 0.0, radians(yaw_deg))
    return replace(START, q_ned_from_frd=attitude, reset_offset_ned_m=offset_ned_m, reset_counter=resets)


@pytest.mark.parametrize("yaw_deg", [-125.0, 105.0, -10.0])
def test_a_step_of_the_heading_names_the_compass_and_its_mounting(yaw_deg: float) -> None:
    problem = ResetWatch(START).problem(after(yaw_deg), MOVE)
    assert "contradicts the compass: check how the compass is mounted" in problem
    assert f"by {abs((yaw_deg - 170.0 + 180.0) % 360.0 - 180.0):.0f}° in one step" in problem


@pytest.mark.parametrize("yaw_deg", [-175.0, 160.0])
def test_a_small_step_of_the_heading_is_borne(yaw_deg: float) -> None:
    assert ResetWatch(START).problem(after(yaw_deg), MOVE) == ""


def test_a_turn_of_the_vehicle_is_no_step() -> None:
    assert ResetWatch(START).problem(after(0.0, resets=0), MOVE) == ""


def test_a_step_of_the_height_alone_is_borne() -> None:
    assert ResetWatch(START).problem(after(offset_ned_m=(0.0, 0.0, 5.0)), MOVE) == ""


@pytest.mark.parametrize("lands", [True, False])
def test_a_landing_goes_on_after_a_step_of_the_position_that_ends_other_goals(lands: bool) -> None:
    state = VehicleState((0.0, 0.0, -3.0), (0.0, 0.0, 0.0), START.q_ned_from_frd, armed=True, landed=False)
    protection = FlightProtection(VEHICLE, START, lands=lands)
    problem = protection.problem(0, after(offset_ned_m=(5.0, 0.0, 0.0)), state, MOVE)
    assert problem == "" if lands else "by 5.0 m in one step" in problem


def test_a_goal_in_a_moving_frame_bears_steps_of_the_position() -> None:
    with_rover = replace(MOVE, frame=MovingFrame())
    assert ResetWatch(START).problem(after(offset_ned_m=(5.0, 0.0, 0.0)), with_rover) == ""
    assert "by 5.0 m in one step" in ResetWatch(START).problem(after(offset_ned_m=(5.0, 0.0, 0.0)), MOVE)


@pytest.mark.parametrize(("step_m", "ends"), [(0.9, False), (1.1, True)])
def test_steps_of_the_position_are_borne_up_to_a_metre_in_sum(step_m: float, ends: bool) -> None:
    watch = ResetWatch(START)
    assert watch.problem(after(offset_ned_m=(0.0, 0.0, 2.0)), MOVE) == "", "the height is borne, and counts as no step"
    problem = watch.problem(after(offset_ned_m=(0.6 * step_m, 0.8 * step_m, 2.0), resets=2), MOVE)
    assert ("by 1.1 m in one step during the goal" in problem) is ends


def test_a_step_that_was_borne_in_a_moving_frame_ends_nothing_after_it_but_the_next_step_does() -> None:
    watch, stepped = ResetWatch(START), after(offset_ned_m=(5.0, 0.0, 0.0))
    assert watch.problem(stepped, replace(MOVE, frame=MovingFrame())) == ""
    assert watch.problem(stepped, MOVE) == ""
    assert "by 5.1 m in 2 steps" in watch.problem(after(offset_ned_m=(5.1, 0.0, 0.0), resets=2), MOVE)


def test_a_step_of_the_heading_ends_a_goal_in_a_moving_frame_too() -> None:
    assert "contradicts the compass" in ResetWatch(START).problem(after(-10.0), replace(MOVE, frame=MovingFrame()))


@pytest.mark.parametrize(
    ("pos_ned_m", "shift_down_m", "ends"),
    [
        ((0.0, 0.0, -119.0), -2.0, True),
        ((0.0, 0.0, -119.0), 0.5, False),
        ((0.0, 0.0, -119.0), 0.0, False),
        ((0.0, 0.0, -121.0), -2.0, False),  # it was beyond the limit before
        (None, -200.0, False),
    ],
)
def test_a_step_of_the_position_that_moves_the_goals_point_beyond_the_limits_ends_the_goal(
    pos_ned_m: Vec3 | None, shift_down_m: float, ends: bool
) -> None:
    """The limit is 120 m over the origin."""
    state = VehicleState(
        (0.0, 0.0, -50.0), (0.0, 0.0, 0.0), START.q_ned_from_frd, True, False, shift_ned_m=(0.0, 0.0, shift_down_m)
    )
    move = replace(MOVE, pos_ned_m=pos_ned_m, vel_ned_mps=(0.0, 0.0, 0.0))
    problem = FlightProtection(VEHICLE, START, lands=False).problem(0, START, state, move)
    assert problem.startswith("the autopilot corrected its position, and with it the goal's: ") is ends
    assert bool(problem) is ends


# -- the ground: only the altimeter counts --

VEHICLE = VehicleConfig()
GROUND_STEP_NS = 50_000_000
BEGIN_NS = 100_000_000_000
"""Vehicle time at which a motion begins."""


def ground_problem(
    clearance_m: float | None, down_mps: float, *, north_mps: float = 0.0, phase: Phase = Phase.GO_TO, steps: int = 5
) -> str:
    """Problem after some steps of 0.05 s in the same state, with an estimated altitude of 8 m."""
    height_m = None if clearance_m is None else clearance_m + VEHICLE.height_altimeter_m
    state = VehicleState((0.0, 0.0, -8.0), (north_mps, 0.0, down_mps), (1.0, 0.0, 0.0, 0.0), True, False, 0.0, height_m)
    feedback = MoveFeedback(pos_uav_ned_m=(0.0, 0.0, -8.0), distance_m=1.0)
    move = Move(phase, feedback, pos_ned_m=(0.0, 0.0, -7.0))
    guard = GroundProximity(VEHICLE)
    return [guard.problem(BEGIN_NS + step * GROUND_STEP_NS, state, move) for step in range(steps)][-1]


@pytest.mark.parametrize(
    ("clearance_m", "down_mps", "ends"),
    [
        (0.57, 1.0, True),  # 1 m/s needs 1² / (2 · 1.5) = 0.33 m, and 0.25 m must be left
        (0.60, 1.0, False),
        (0.20, 0.05, True),
        (0.20, -0.5, False),  # climbs
        (0.05, 0.0, True),  # stands
        (0.15, 0.0, False),  # hovers low
        (3.0, 2.0, False),
    ],
)
def test_a_goal_ends_while_there_is_still_room_to_brake(clearance_m: float, down_mps: float, ends: bool) -> None:
    assert bool(ground_problem(clearance_m, down_mps)) is ends


def test_the_reason_has_the_measured_height() -> None:
    assert "measures only 0.2 m below the vehicle's feet" in ground_problem(0.2, 0.5)


def test_a_low_vehicle_that_only_moves_sideways_flies_on() -> None:
    assert not ground_problem(0.2, 0.0, north_mps=1.0)


@pytest.mark.parametrize(("north_mps", "ends"), [(0.05, True), (0.15, False)])
def test_a_vehicle_that_stands_is_slower_than_a_tenth_of_a_metre_per_second(north_mps: float, ends: bool) -> None:
    assert bool(ground_problem(0.05, 0.0, north_mps=north_mps)) is ends


def test_feet_that_are_in_the_ground_by_the_altimeter_are_at_zero_metres() -> None:
    assert "measures only 0.0 m below the vehicle's feet" in ground_problem(-0.1, 0.5)


@pytest.mark.parametrize(
    ("clearances_m", "ends"),
    [
        ([0.1] * 3, False),  # for 0.1 s
        ([0.1] * 5, True),  # for 0.2 s
        ([0.1, 0.1, 0.1, 2.0, 0.1, 0.1], False),  # high in between
        ([0.1, 0.1, None, None, 0.1], True),  # without a reading nothing changes
    ],
)
def test_a_vehicle_must_be_low_for_some_time_without_a_break(clearances_m: list[float | None], ends: bool) -> None:
    guard = GroundProximity(VEHICLE)
    problem = ""
    for step, clearance_m in enumerate(clearances_m):
        height_m = None if clearance_m is None else clearance_m + VEHICLE.height_altimeter_m
        state = VehicleState((0.0, 0.0, -8.0), (0.0, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0), True, False, 0.0, height_m)
        problem = guard.problem(BEGIN_NS + step * GROUND_STEP_NS, state, MOVE)
    assert bool(problem) is ends


def test_the_time_near_the_ground_in_a_takeoff_does_not_count_after_it() -> None:
    guard, state = GroundProximity(VEHICLE), replace(at(0.0), height_m=VEHICLE.height_altimeter_m + 0.05)
    phases = [*[Phase.GO_TO] * 2, Phase.TAKEOFF, *[Phase.GO_TO] * 2]
    problems = [
        guard.problem(BEGIN_NS + step * GROUND_STEP_NS, state, replace(MOVE, phase=phase))
        for step, phase in enumerate(phases)
    ]
    assert problems == [""] * 5


@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.LANDING])
def test_takeoff_and_landing_may_be_at_the_ground(phase: Phase) -> None:
    assert not ground_problem(0.05, 0.5, phase=phase)


def test_a_single_reading_ends_nothing() -> None:
    assert not ground_problem(0.0, 1.0, steps=1)


def test_without_an_altimeter_nothing_is_concluded() -> None:
    assert not ground_problem(None, 1.0)


@pytest.mark.parametrize(
    ("state_at", "words"),
    [
        (lambda t: replace(at(0.0), vel_uav_ned_mps=(0.0, 0.0, 0.5), height_m=0.3), "the altimeter measures only"),
        (lambda t: at(t * t, 2.0 * t), "the vehicle runs away from its setpoint"),
        (lambda t: at(0.0), ""),
    ],
    ids=["into the ground", "away", "hover"],
)
@pytest.mark.parametrize("lands", [True, False])
def test_each_protection_of_a_flight_ends_it_alone(
    state_at: Callable[[float], VehicleState], words: str, lands: bool
) -> None:
    protection = FlightProtection(VEHICLE, START, lands=lands)
    problems = [
        protection.problem(BEGIN_NS + round(0.1 * step * 1e9), START, state_at(0.1 * step), position(0.0))
        for step in range(25)
    ]
    assert any(problem.startswith(words) for problem in problems if problem) is bool(words)
    assert any(problems) is bool(words)


# -- a vehicle that runs away --

STEP_S = 0.02
ORIGIN: Vec3 = (0.0, 0.0, -3.0)


def at(
    north_m: float, vel_north_mps: float = 0.0, *, landed: bool = False, wind_mps: float | None = 0.0
) -> VehicleState:
    return VehicleState(
        (north_m, 0.0, -3.0),
        (vel_north_mps, 0.0, 0.0),
        (1.0, 0.0, 0.0, 0.0),
        armed=True,
        landed=landed,
        wind_ned_mps=None if wind_mps is None else (0.6 * wind_mps, 0.8 * wind_mps, 0.0),
        std_gust_mps=None if wind_mps is None else 0.0,
    )


def position(north_m: float) -> Move:
    return Move(Phase.GO_TO, MoveFeedback(pos_uav_ned_m=ORIGIN, distance_m=0.0), pos_ned_m=(north_m, 0.0, -3.0))


def velocity(north_mps: float, target_north_m: float | None = None) -> Move:
    target_ned_m = None if target_north_m is None else (target_north_m, 0.0, 0.0)
    feedback = MoveFeedback(pos_uav_ned_m=ORIGIN, distance_m=0.0)
    return Move(Phase.LANDING, feedback, vel_ned_mps=(north_mps, 0.0, 0.0), target_ned_m=target_ned_m)


def fires_after_s(
    motion: Callable[[float], tuple[VehicleState, Move]], duration_s: float = 10.0, step_s: float = STEP_S
) -> float | None:
    """Time of the first problem of a motion, given as state and setpoint at a time in s; None without one."""
    detector = RunawayDetector()
    for step in range(round(duration_s / step_s)):
        state, move = motion(step * step_s)
        if detector.problem(BEGIN_NS + round(step * step_s * 1e9), state, move):
            return step * step_s
    return None


def test_a_vehicle_that_accelerates_away_is_found_after_two_seconds_with_its_numbers() -> None:
    detector = RunawayDetector()
    reasons = [
        detector.problem(BEGIN_NS + step * 100_000_000, at(0.5 * (0.1 * step) ** 2, 0.1 * step), position(0.0))
        for step in range(21)
    ]
    assert reasons[:-1] == [""] * 20
    # x = t²/2: 2.0 m after 2 s.
    assert "its position is 2.0 m off, and the error grew by 2.0 m in 2.0 s against the command" in reasons[-1]
    assert "check the compass" in reasons[-1]


@pytest.mark.parametrize(
    ("motion", "expected_s"),
    [
        (lambda t: (at(0.6 * t, 0.6), position(0.0)), 2.0),  # at a constant speed: 1.2 m in 2 s
        (lambda t: (at(0.4 * t, 0.4), position(0.0)), None),  # 0.8 m in 2 s are a slow drift
        (lambda t: (at(0.0, 0.3 * t * t), velocity(0.0)), 2.0),  # 1.2 m/s in 2 s
        (lambda t: (at(0.0, 0.4 * t), velocity(0.0)), None),
        (lambda t: (at(t * t, 2.0 * t), velocity(-1.0, 0.0)), 2.0),  # a landing's velocity leads back to its target
        (lambda t: (at(t * t, 2.0 * t), velocity(1.0, 0.0)), None),  # a velocity that leads away is obeyed
        (lambda t: (at(t * t, 2.0 * t, landed=True), position(0.0)), None),
    ],
    ids=["steady", "drift", "velocity", "slow velocity", "target", "commanded away", "landed"],
)
def test_the_error_must_grow_by_a_metre_or_a_metre_per_second_against_the_command(
    motion: Callable[[float], tuple[VehicleState, Move]], expected_s: float | None
) -> None:
    fired_s = fires_after_s(motion, 6.0)
    assert fired_s == (None if expected_s is None else pytest.approx(expected_s, abs=0.21))


@pytest.mark.parametrize(
    ("wind_mps", "grown_m", "found"),
    [
        (5.0, 4.0, False),  # 1 m and 2 s * 0.4 * 5 m/s are permitted: 5 m
        (5.0, 6.0, True),
        (None, 10.0, False),  # before the wind is known it is 12 m/s: 10.6 m
        (None, 12.0, True),
        (40.0, 12.0, True),  # a stronger wind permits no more
    ],
)
def test_a_known_wind_may_push_the_vehicle_farther_and_an_unknown_one_too(
    wind_mps: float | None, grown_m: float, found: bool
) -> None:
    speed_mps = 0.5 * grown_m
    fired_s = fires_after_s(lambda t: (at(speed_mps * t, speed_mps, wind_mps=wind_mps), position(0.0)))
    assert (fired_s is not None) is found


def test_gusts_count_as_wind() -> None:
    """5 m/s and gusts of 3 m/s permit 1 m and 2 s * 0.4 * 8 m/s: 7.4 m."""
    for grown_m, found in ((7.0, False), (8.0, True)):
        speed_mps = 0.5 * grown_m
        fired_s = fires_after_s(
            lambda t, v=speed_mps: (replace(at(v * t, v, wind_mps=5.0), std_gust_mps=3.0), position(0.0))  # type: ignore[misc]
        )
        assert (fired_s is not None) is found


def test_an_error_that_grows_more_slowly_in_its_second_half_is_braked() -> None:
    """x = 3 t - 0.6 t²: 3 m/s at first, 0.6 m/s after 2 s, and 3.6 m away then."""
    assert fires_after_s(lambda t: (at(3.0 * t - 0.6 * t * t, 3.0 - 1.2 * t), position(0.0)), 2.4) is None
    assert fires_after_s(lambda t: (at(0.6 * t + 0.6 * t * t, 0.6 + 1.2 * t), position(0.0)), 2.4) is not None


@pytest.mark.parametrize("step_s", [0.02, 0.23])
def test_an_error_that_is_braked_a_little_is_no_runaway_whether_its_samples_are_even_or_odd(step_s: float) -> None:
    """x = 3 t - 0.2 t²: 3 m/s at first, and 2.2 m/s after 2 s; a sample every 0.2 s or 0.23 s."""
    assert fires_after_s(lambda t: (at(3.0 * t - 0.2 * t * t, 3.0 - 0.4 * t), position(0.0)), 5.0, step_s) is None
    assert fires_after_s(lambda t: (at(3.0 * t + 0.2 * t * t, 3.0 + 0.4 * t), position(0.0)), 5.0, step_s) is not None


def test_a_landing_runs_away_from_its_target_in_any_direction_but_not_when_its_velocity_leads_away() -> None:
    """The vehicle accelerates away from a target at (0, 0), and is commanded back to it, or away."""
    for north, east in ((1.0, 0.0), (0.0, 1.0), (0.6, 0.8), (-0.6, 0.8), (0.8, -0.6)):
        for back_mps, found in ((1.0, True), (-1.0, False)):
            command = Move(
                Phase.LANDING,
                None,
                vel_ned_mps=(-back_mps * north, -back_mps * east, 0.0),
                target_ned_m=(0.0, 0.0, 0.0),
            )

            def motion(
                t: float, north: float = north, east: float = east, command: Move = command
            ) -> tuple[VehicleState, Move]:
                away_m = 0.5 + t * t
                return replace(at(0.0), pos_uav_ned_m=(north * away_m, east * away_m, -3.0)), command

            assert (fires_after_s(motion, 4.0) is not None) is found, (north, east, back_mps)


def test_a_move_without_position_and_velocity_and_a_disarmed_vehicle_run_nowhere() -> None:
    nothing = Move(Phase.GO_TO, None, yaw_rad=0.0)
    assert fires_after_s(lambda t: (at(t * t, 2.0 * t), nothing)) is None
    assert fires_after_s(lambda t: (replace(at(t * t, 2.0 * t), armed=False), position(0.0))) is None


def test_a_landing_beside_its_target_that_only_sinks_is_no_runaway() -> None:
    """Only the horizontal error to the target counts: here none grows."""
    sinks = Move(Phase.LANDING, None, vel_ned_mps=(0.1, 0.0, 1.0), target_ned_m=(3.0, 0.0, 0.0))
    assert fires_after_s(lambda t: (replace(at(0.0), pos_uav_ned_m=(0.0, 0.0, -9.0 + 3.0 * t)), sinks)) is None


def test_the_wind_that_a_runaway_itself_pretends_permits_nothing() -> None:
    """The estimated wind grows from 0 with the speed of the vehicle."""
    assert fires_after_s(lambda t: (at(t * t, 2.0 * t, wind_mps=4.0 * t), position(0.0)), 4.0) is not None


def test_gusts_that_push_the_vehicle_by_two_metres_to_and_fro_are_no_runaway() -> None:
    """Half a period of 3.5 s, in which the error grows for 1.75 s."""
    assert fires_after_s(lambda t: (at(2.0 * sin(1.8 * t)), position(0.0)), 30.0) is None
    assert fires_after_s(lambda t: (at(0.0, 2.0 * sin(1.8 * t)), velocity(0.0)), 30.0) is None


def test_an_error_that_falls_for_a_quarter_of_each_second_is_no_runaway() -> None:
    """It grows by 1.5 m/s for 0.78 s, and falls by 0.8 m/s for 0.22 s: by 2 m in two seconds."""

    def to_and_fro(t: float) -> tuple[VehicleState, Move]:
        whole_s, part_s = divmod(t, 1.0)
        return at(
            whole_s * (0.78 * 1.5 - 0.22 * 0.8) + min(part_s, 0.78) * 1.5 - max(part_s - 0.78, 0.0) * 0.8
        ), position(0.0)

    assert fires_after_s(to_and_fro) is None
    assert fires_after_s(lambda t: (at(t), position(0.0))) is not None, "without a break it is one"


def test_a_vehicle_that_brakes_after_a_takeover_is_no_runaway() -> None:
    """At first 8 m/s away from the new setpoint, braking with 2.5 m/s² for 3.2 s and 12.8 m."""

    def braking(t: float) -> tuple[VehicleState, Move]:
        braked_s = min(t, 3.2)
        return at(8.0 * braked_s - 1.25 * braked_s**2, 8.0 - 2.5 * braked_s), position(0.0)

    assert fires_after_s(braking) is None


def test_a_setpoint_that_moves_away_faster_than_the_vehicle_follows_is_no_runaway() -> None:
    """A platform that drives at 3 m/s, a vehicle that follows at 1 m/s, or stands, or hovers ahead of it."""
    assert fires_after_s(lambda t: (at(1.0 * t, 1.0), velocity(1.0, 3.0 * t))) is None
    assert fires_after_s(lambda t: (at(0.0), position(3.0 * t))) is None
    assert fires_after_s(lambda t: (at(2.0 + 1.0 * t, 1.0), velocity(1.0, 1.0 * t))) is None
    assert fires_after_s(lambda t: (at(1.0 * t, 1.0), velocity(1.0, -3.0 * t))) is None


@pytest.mark.parametrize(
    ("speeds_mps", "found"),
    [
        ((1.0, 1.0, 4.0, 4.0, 4.0, 2.0, 2.0, 2.0, 2.0, 2.0), False),  # 2.8 m in the first second, then 2 m
        ((4.0, 4.0, 1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0), True),  # 2.2 m in the first second, then 2.6 m
    ],
)
def test_the_second_half_of_the_two_seconds_is_compared_with_the_first(
    speeds_mps: tuple[float, ...], found: bool
) -> None:
    """A speed for each fifth of a second."""
    away_m = [0.2 * speed_sum for speed_sum in accumulate(speeds_mps, initial=0.0)]
    detector = RunawayDetector()
    problems = [
        detector.problem(BEGIN_NS + step * 200_000_000, at(north_m), position(0.0))
        for step, north_m in enumerate(away_m)
    ]
    assert any(problems) is found


@pytest.mark.parametrize(
    ("vehicle_mps", "setpoint_mps", "found"),
    [
        (2.4, 2.0, False),  # both move: the error grows by 0.8 m in 2 s
        (2.6, 2.0, True),  # by 1.2 m
        (0.4, -2.0, False),  # the vehicle's own motion is 0.8 m in 2 s
        (0.6, -2.0, True),  # 1.2 m
    ],
)
def test_both_the_error_and_the_vehicles_own_motion_must_be_a_metre_in_two_seconds(
    vehicle_mps: float, setpoint_mps: float, found: bool
) -> None:
    fired_s = fires_after_s(lambda t: (at(vehicle_mps * t, vehicle_mps), position(setpoint_mps * t)), 5.0)
    assert (fired_s is not None) is found


def test_steps_of_the_position_and_of_the_velocity_by_a_reset_are_no_runaway() -> None:
    assert fires_after_s(lambda t: (at(0.0 if t < 3.0 else 8.0), position(0.0))) is None
    assert fires_after_s(lambda t: (at(0.0, 0.0 if t < 3.0 else 4.0), velocity(0.0))) is None
    assert fires_after_s(lambda t: (at(0.0), position(0.0 if t < 3.0 else 8.0))) is None


def test_a_change_from_positions_to_velocities_begins_anew() -> None:
    """Each kind of setpoint is given for 1.5 s only."""

    def alternating(t: float) -> tuple[VehicleState, Move]:
        return at(t * t, 2.0 * t), position(0.0) if t % 3.0 < 1.5 else velocity(0.0)

    assert fires_after_s(alternating, 9.0) is None


@pytest.mark.parametrize(
    "goal",
    [GoToGoal(target_ned_m=(20.0, 0.0, -3.0)), CIRCLE, FIELD, SPOT],
    ids=["go_to", "get_images", "area_coverage", "land_on_spot"],
)
def test_every_goal_of_a_vehicle_with_a_wrong_heading_ends_within_some_seconds(goal: Goal) -> None:
    world = World()
    world.bus.add(FakeCamera())
    world.bridge.wind_ned_mps = (0.0, 0.0, 0.0)
    world.bus.run_for(0.5)
    answers = world.send(goal)
    world.bus.run_for(1.5)
    world.bridge.error_heading_rad = radians(90.0)
    start_ned_m = world.bridge.pos_ned_m
    assert world.bus.run_for(6.0, lambda: answers.ended), answers.replies[-1]
    result = answers.replies[-1]
    assert isinstance(result, Result)
    assert result.outcome == "aborted"
    assert "the vehicle runs away from its setpoint" in result.reason
    assert distance(world.bridge.pos_ned_m, start_ned_m) < 15.0
    assert world.bridge.releases[-1].then == "hover"
