"""Which steps of the autopilot's estimate a goal bears."""

from math import radians

import pytest
from msgspec.structs import replace

from jezero.frames import Vec3, quat_from_euler
from jezero.schemas.commands import Phase
from jezero.schemas.state import Odometry
from jezero.services.actions.lifecycle.reset_watch import ResetWatch
from jezero.services.actions.motion.behaviour import Move, MovingFrame

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


def test_a_goal_in_a_moving_frame_bears_steps_of_the_position() -> None:
    with_rover = replace(MOVE, frame=MovingFrame())
    assert ResetWatch(START).problem(after(offset_ned_m=(5.0, 0.0, 0.0)), with_rover) == ""
    assert "by 5.0 m in one step" in ResetWatch(START).problem(after(offset_ned_m=(5.0, 0.0, 0.0)), MOVE)
