"""State of the simulated vehicle, as the physics knows it and the sensors see it."""

from typing import NamedTuple

from jezero.frames import Quat, Vec3


class BodyState(NamedTuple):
    """Truth after a physics step.

    Attributes:
        pos_ned_m: centre of mass in the map.
        rates_frd_rps: mean over the step.
        acc_frd_mps2: mean specific force over the step, from the difference of velocities: in contact the sum of
            forces is not known otherwise.
    """

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    q_ned_from_frd: Quat
    rates_frd_rps: Vec3
    acc_frd_mps2: Vec3


class RoverState(NamedTuple):
    """Pose and motion of the landing platform's centre; the platform stays level."""

    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    yaw_rad: float
    speed_mps: float
    yaw_rate_rps: float
