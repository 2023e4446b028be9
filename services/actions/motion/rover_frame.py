"""Flying in the rover's frame: what a behaviour sees and commands there, in terms of the world's."""

from msgspec.structs import replace

from jezero.frames import Vec3, add, subtract
from jezero.schemas.actions import MoveFeedback
from jezero.schemas.estimate import Relative
from jezero.services.actions.lifecycle.behaviour import Move, VehicleState

HINT = "use frame 'world', or see that the estimator finds the rover"


def lost_reason(relative: Relative | None) -> str:
    """Why the rover's frame is not known now, or ""."""
    if relative is None:
        return f"frame 'rover' needs the rover's estimate, and the estimator is silent: {HINT}"
    if not relative.valid:
        return f"frame 'rover' needs the rover's estimate: {relative.reason}; {HINT}"
    return ""


def seen_from_rover(state: VehicleState, relative: Relative) -> VehicleState:
    """The vehicle's state with position and velocity relative to the rover."""
    return replace(
        state,
        pos_uav_ned_m=relative.pos_uav_rel_rover_ned_m,
        vel_uav_ned_mps=relative.vel_uav_rel_rover_ned_mps,
    )


def in_world(move: Move, state: VehicleState, relative: Relative) -> Move:
    """A move relative to the rover as one in the world, with the rover's motion added; the feedback stays.

    Args:
        state: of the vehicle in the world.
    """
    assert move.pos_ned_m is not None and move.vel_ned_mps is not None and move.acc_ned_mps2 is not None
    pos_rover_ned_m = subtract(state.pos_uav_ned_m, relative.pos_uav_rel_rover_ned_m)
    north_mps, east_mps, _ = relative.vel_rover_ned_mps
    rate_rps = relative.yaw_rate_rover_rps
    turn_ned_mps2: Vec3 = (-rate_rps * east_mps, rate_rps * north_mps, 0.0)
    assert isinstance(move.feedback, MoveFeedback)
    feedback = MoveFeedback(
        pos_uav_ned_m=relative.pos_uav_rel_rover_ned_m, frame="rover", distance_m=move.feedback.distance_m
    )
    return replace(
        move,
        feedback=feedback,
        pos_ned_m=add(move.pos_ned_m, pos_rover_ned_m),
        vel_ned_mps=add(move.vel_ned_mps, relative.vel_rover_ned_mps),
        acc_ned_mps2=add(move.acc_ned_mps2, turn_ned_mps2),
    )
