"""True states of the simulated vehicle and rover, which the sensors measure."""

from typing import NamedTuple

from jezero.base.frames import Quat, Vec3


class BodyState(NamedTuple):
    """Truth after a physics step.

    Attributes:
        pos_ned_m: centre of mass in the map.
        vel_ned_mps: velocity at the end of the step.
        q_ned_from_frd: attitude at the end of the step.
        rates_frd_rps: mean angular rates over the step.
        acc_frd_mps2: mean specific force over the step, from the difference of velocities: the contact forces are not
            known.
    """

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    q_ned_from_frd: Quat
    rates_frd_rps: Vec3
    acc_frd_mps2: Vec3


class RoverState(NamedTuple):
    """Pose and motion of the landing platform's centre.

    Attributes:
        pos_ned_m: centre of the platform's surface in the map.
        vel_ned_mps: velocity.
        q_ned_from_rover_body: attitude of the platform.
        rates_ned_rps: angular rates in the map's axes.
        yaw_rad: heading, as the compass measures it.
        speed_mps: forward speed.
        yaw_rate_rps: yaw rate, clockwise seen from above.
    """

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    q_ned_from_rover_body: Quat
    rates_ned_rps: Vec3
    yaw_rad: float
    speed_mps: float
    yaw_rate_rps: float
