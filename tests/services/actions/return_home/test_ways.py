"""The way of a return to a rover whose position is wrong at first."""

from msgspec.structs import replace

from jezero.frames import Vec3
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.goals import ReturnHomeGoal
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Move, Selection, VehicleState
from jezero.services.actions.return_home.behaviour import ReturnHome
from jezero.services.actions.return_home.config import ReturnHomeConfig

HERE = (30.0, 0.0, -5.0)
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
    selection = Selection(use_uwb=True, use_tag=True)
    return ReturnHome(ReturnHomeGoal(), (0.0, 0.0, 0.0), selection, ReturnHomeConfig(), ActionsConfig(), 0, state)


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
