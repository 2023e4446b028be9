"""Attitude of the rover's platform, by which anchors and tags aren't where they are on a level platform."""

from math import cos, sin

import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import quat_from_euler, quat_rotate
from jezero.schemas.sensors import RoverOdometry

LEVEL = np.eye(3)


def level_from_rover_body(rover: RoverOdometry) -> Array:
    """(3, 3) rotation from rover_body to level axes with the rover's heading."""
    q = quat_from_euler(rover.roll_rover_rad, rover.pitch_rover_rad, 0.0)
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return np.array([quat_rotate(q, axis) for axis in axes]).T


def ned_from_level(heading_rad: float) -> Array:
    """(3, 3) rotation from level axes with this heading to NED."""
    c, s = cos(heading_rad), sin(heading_rad)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
