"""The way of a return: to a rover whose position is wrong at first, and around a fence."""

from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.fence import Fence, Zone
from jezero.schemas.goals import ReturnHomeGoal, ReturnResult
from jezero.services.actions.config import ActionsConfig, ReturnHomeConfig
from jezero.services.actions.motion.behaviour import Move, Selection, VehicleState
from jezero.services.actions.return_home.behaviour import ReturnHome

# -- to a rover --

HERE = (30.0, 0.0, -5.0)
SELECTION = Selection(use_uwb=True, use_tag=True)
ROVER = RoverEstimate(
    t_ns=0,
    epoch_id=1,
    valid=True,
    pos_rover_ned_m=(0.0, 0.0, 0.0),
    vel_rover_ned_mps=(0.0, 0.0, 0.0),
    yaw_rover_rad=0.0,
    std_pos_m=0.1,
)


def state_with_rover(pos_rover_ned_m: Vec3) -> VehicleState:
    rover = replace(ROVER, pos_rover_ned_m=pos_rover_ned_m)
    return VehicleState(HERE, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, False, rover=rover)


def return_to(state: VehicleState) -> ReturnHome:
    return ReturnHome(ReturnHomeGoal(), (0.0, 0.0, 0.0), SELECTION, ActionsConfig(), 0, state)


def highest_m(flight: ReturnHome, state: VehicleState) -> float:
    return max(-z for _, _, z in flight.path(state))


def test_the_way_to_a_high_rover_ends_at_the_greatest_height() -> None:
    state = state_with_rover((0.0, 0.0, -118.0))
    assert highest_m(return_to(state), state) == 120.0


def test_a_rover_that_was_believed_far_up_is_flown_to_where_it_comes_into_sight() -> None:
    before, after = state_with_rover((100.0, 0.0, -90.0)), state_with_rover((0.0, 0.0, 0.0))
    flight = return_to(before)
    assert isinstance(flight.step(20_000_000, before), Move)
    assert highest_m(flight, before) > 90.0
    assert isinstance(flight.step(40_000_000, after), Move)
    assert highest_m(flight, after) == ReturnHomeConfig().safe_height_m
    assert flight.path(after)[-1] == (0.0, 0.0, 0.0)


def test_a_rover_that_drives_on_does_not_begin_the_way_anew() -> None:
    flight = return_to(state_with_rover((0.0, 0.0, 0.0)))
    corners = []
    for i in range(1, 10):
        state = state_with_rover((0.2 * i, 0.0, 0.0))
        flight.step(20_000_000 * i, state)
        corners.append(flight.path(state)[1:-1])
    assert all(each == corners[0] for each in corners)


# -- where the way to an earlier place leaves the fence --

WALL = Zone(name="wall", corners_ned_m=((14.0, -50.0), (16.0, -50.0), (16.0, 50.0), (14.0, 50.0)))


def place_of_return(
    rally_points_ned_m: tuple[tuple[float, float], ...],
    takeoff_ned_m: Vec3 | None,
    of_goal_ned_m: tuple[tuple[float, float], ...] = (),
) -> ReturnResult:
    """The place that a return begins with, with a wall in the way to the world's origin."""
    state = VehicleState(HERE, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, False, fence=Fence(keep_out=(WALL,)))
    goal = ReturnHomeGoal(rally_points_ned_m=of_goal_ned_m)
    settings = ReturnHomeConfig(rally_points_ned_m=rally_points_ned_m)
    flight = ReturnHome(goal, takeoff_ned_m, SELECTION, ActionsConfig(return_home=settings), 0, state)
    return flight.result(False, HERE)


def test_a_rally_point_on_this_side_of_the_zone_is_taken_instead_of_the_takeoff_point() -> None:
    result = place_of_return(((40.0, 5.0),), (0.0, 0.0, 0.0))
    assert result.place == "rally_point"
    assert "the takeoff point is left out: the way leaves the fence 'fence'" in result.reason
    assert "the zone 'wall' to stay out of, at north 1" in result.reason


def test_a_takeoff_point_on_this_side_of_the_zone_is_taken() -> None:
    result = place_of_return((), (20.0, 3.0, 0.0))
    assert result.place == "takeoff_point"
    assert "left out" not in result.reason


def test_behind_a_zone_on_all_ways_the_vehicle_lands_here() -> None:
    result = place_of_return(((5.0, 5.0),), (0.0, 0.0, 0.0))
    assert result.place == "here"
    assert "the takeoff point is left out" in result.reason and "the rally point is left out" in result.reason


def test_a_rally_point_of_the_goal_counts_as_one_of_the_settings_does() -> None:
    assert place_of_return((), (0.0, 0.0, 0.0), ((40.0, 5.0),)).place == "rally_point"


def test_a_rally_point_beyond_the_limits_is_none() -> None:
    assert place_of_return((), None, ((9e5, 0.0),)).place == "here"
