"""Which place a return takes when the way to an earlier one leaves the fence."""

from jezero.frames import Vec3
from jezero.schemas.fence import Fence, Zone
from jezero.schemas.goals import ReturnHomeGoal, ReturnResult
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Selection, VehicleState
from jezero.services.actions.return_home.behaviour import ReturnHome
from jezero.services.actions.return_home.config import ReturnHomeConfig

HERE = (30.0, 0.0, -5.0)
SELECTION = Selection(use_uwb=True, use_tag=True)
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
    flight = ReturnHome(goal, takeoff_ned_m, SELECTION, settings, ActionsConfig(), 0, state)
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
