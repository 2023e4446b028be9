"""Conversions between the rover's frame and the world's, by numbers worked out by hand."""

from msgspec.structs import replace

from jezero.schemas.commands import Phase
from jezero.schemas.estimate import Relative
from jezero.schemas.goals import MoveFeedback
from jezero.services.actions.motion.behaviour import Done, Move, VehicleState
from jezero.services.actions.motion.rover_frame import rover_position, step_in_rover_frame, turn_acceleration

RELATIVE = Relative(
    t_ns=0,
    epoch_id=1,
    valid=True,
    pos_uav_rel_rover_ned_m=(1.0, 2.0, -3.0),
    vel_uav_rel_rover_ned_mps=(0.5, 0.0, 0.0),
    vel_rover_ned_mps=(2.0, 1.0, 0.0),
    yaw_rover_rad=0.0,
    yaw_rate_rover_rps=0.5,
    use_uwb=True,
    use_tag=True,
    cov=(0.0,) * 21,
)
STATE = VehicleState(
    (11.0, 22.0, -4.0), (2.5, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0), armed=True, landed=False, relative=RELATIVE
)


def stand_over_the_rover(t_ns: int, state: VehicleState) -> Move:
    feedback = MoveFeedback(pos_uav_ned_m=state.pos_uav_ned_m, frame="rover", distance_m=0.0)
    return Move(Phase.GO_TO, feedback, (0.0, 0.0, -3.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_the_rovers_position_is_the_vehicles_less_the_relative_one() -> None:
    assert rover_position(STATE, RELATIVE) == (10.0, 20.0, -1.0)


def test_a_rover_that_drives_north_and_turns_east_accelerates_east() -> None:
    assert turn_acceleration((2.0, 0.0, 0.0), 0.5) == (0.0, 1.0)
    assert turn_acceleration((0.0, 2.0, 0.0), 0.5) == (-1.0, 0.0)


def test_a_move_in_the_rovers_frame_goes_along_with_the_rover() -> None:
    move = step_in_rover_frame(stand_over_the_rover, 0, STATE)
    assert isinstance(move, Move)
    assert move.pos_ned_m == (10.0, 20.0, -4.0)
    assert move.vel_ned_mps == (2.0, 1.0, 0.0)
    assert move.acc_ned_mps2 == (-0.5, 1.0, 0.0)
    assert move.feedback.frame == "rover"
    assert move.feedback.pos_uav_ned_m == (1.0, 2.0, -3.0)


def test_a_velocity_setpoint_stays_without_a_position() -> None:
    move = step_in_rover_frame(lambda t_ns, state: replace(stand_over_the_rover(t_ns, state), pos_ned_m=None), 0, STATE)
    assert isinstance(move, Move)
    assert move.pos_ned_m is None and move.vel_ned_mps == (2.0, 1.0, 0.0)


def test_the_hover_point_at_the_end_is_in_the_world() -> None:
    done = step_in_rover_frame(lambda t_ns, state: Done("succeeded", hover_pos_ned_m=(0.0, 0.0, -3.0)), 0, STATE)
    assert done == Done("succeeded", hover_pos_ned_m=(10.0, 20.0, -4.0))


def test_a_flight_without_an_estimate_ends_with_the_reason() -> None:
    for relative, reason in ((None, "silent"), (replace(RELATIVE, valid=False, reason="out of sight"), "out of sight")):
        done = step_in_rover_frame(stand_over_the_rover, 0, replace(STATE, relative=relative))
        assert isinstance(done, Done) and done.outcome == "aborted" and reason in done.reason
