"""What each format gives: the motion of the rover at one time."""

import msgspec


class RoverMotion(msgspec.Struct, frozen=True):
    """One measurement of the rover's motion.

    Attributes:
        yaw_rad: heading in NED, clockwise from north, from -pi to pi.
        speed_mps: speed along the heading; negative is backwards.
        yaw_rate_rps: yaw rate, clockwise as seen from above.
        roll_rad: roll of the platform; 0 where it isn't measured.
        pitch_rad: pitch of the platform, as its roll.
    """

    yaw_rad: float
    speed_mps: float
    yaw_rate_rps: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
