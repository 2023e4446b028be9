"""Flight in the rover's frame, whose axes are the world's and whose origin moves with the rover.

A behaviour that flies there gets the vehicle's state relative to the rover, and its setpoints are converted to the
world with the rover's motion added.
"""

from collections.abc import Callable

from msgspec.structs import replace

from jezero.base.frames import Vec3, add, subtract
from jezero.schemas.estimate import Relative
from jezero.services.actions.motion.behaviour import Done, Move, MovingFrame, VehicleState

HINT = "use frame 'world', or check that the estimator finds the rover"


def loss_reason(relative: Relative | None) -> str:
    """Reason why the rover's frame is not known now, or ""."""
    if relative is None:
        return f"frame 'rover' needs the rover's estimate, and the estimator is silent: {HINT}"
    if not relative.valid:
        return f"frame 'rover' needs the rover's estimate: {relative.reason}; {HINT}"
    return ""


def rover_position(state: VehicleState, relative: Relative) -> Vec3:
    """Position of the rover in the world frame, m: the origin of the rover's frame."""
    return subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)


def turn_acceleration(vel_rover_ned_mps: Vec3, yaw_rate_rover_rps: float) -> tuple[float, float]:
    """Centripetal acceleration of a rover that turns while it drives; (2,) north and east, m/s²."""
    north_mps, east_mps, _ = vel_rover_ned_mps
    return -yaw_rate_rover_rps * east_mps, yaw_rate_rover_rps * north_mps


def state_in_rover_frame(state: VehicleState, relative: Relative) -> VehicleState:
    """State of the vehicle with position and velocity relative to the rover."""
    return replace(
        state,
        pos_uav_ned_m=relative.pos_uav_rel_rover_ned_m,
        vel_uav_ned_mps=relative.vel_uav_rel_rover_ned_mps,
    )


def move_in_world(move: Move, state: VehicleState, relative: Relative) -> Move:
    """Convert a move relative to the rover to one in the world, with the rover's motion added; the feedback stays.

    Args:
        state: of the vehicle in the world.
    """
    pos_ned_m, vel_ned_mps, acc_ned_mps2 = move.pos_ned_m, move.vel_ned_mps, move.acc_ned_mps2
    target_ned_m = move.target_ned_m
    turn_ned_mps2 = (*turn_acceleration(relative.vel_rover_ned_mps, relative.yaw_rate_rover_rps), 0.0)
    frame = MovingFrame(rover_position(state, relative), relative.vel_rover_ned_mps, turn_ned_mps2)
    return replace(
        move,
        pos_ned_m=None if pos_ned_m is None else add(pos_ned_m, frame.pos_ned_m),
        vel_ned_mps=None if vel_ned_mps is None else add(vel_ned_mps, frame.vel_ned_mps),
        acc_ned_mps2=None if acc_ned_mps2 is None else add(acc_ned_mps2, frame.acc_ned_mps2),
        target_ned_m=None if target_ned_m is None else add(target_ned_m, frame.pos_ned_m),
        frame=frame,
    )


def step_in_rover_frame(
    step: Callable[[int, VehicleState], Move | Done], t_ns: int, state: VehicleState
) -> Move | Done:
    """Next move in the world of a flight in the rover's frame; its end when that frame is not known any more.

    Args:
        step: the flight's step, with state and result in the rover's frame.
        state: of the vehicle in the world.
    """
    relative = state.relative
    if relative is None or not relative.valid:
        return Done("aborted", loss_reason(relative))
    move = step(t_ns, state_in_rover_frame(state, relative))
    if isinstance(move, Move):
        return move_in_world(move, state, relative)
    if move.hover_pos_ned_m is None:
        return move
    return replace(move, hover_pos_ned_m=add(move.hover_pos_ned_m, rover_position(state, relative)))
