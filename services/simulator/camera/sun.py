"""Direction of the sun, and shadows of points."""

from math import cos, radians, sin

from jezero.base.frames import Vec3

SUN_AZIMUTH_DEG = 310.0
SUN_ELEVATION_DEG = 48.0
TO_SUN_NED: Vec3 = (
    cos(radians(SUN_ELEVATION_DEG)) * cos(radians(SUN_AZIMUTH_DEG)),
    cos(radians(SUN_ELEVATION_DEG)) * sin(radians(SUN_AZIMUTH_DEG)),
    -sin(radians(SUN_ELEVATION_DEG)),
)
"""Unit vector towards the sun."""


def shadow_of(point_ned_m: Vec3, down_surface_m: float) -> Vec3:
    """Shadow of a point on a level surface."""
    north, east, down = point_ned_m
    steps = (down_surface_m - down) / TO_SUN_NED[2]
    return (north + steps * TO_SUN_NED[0], east + steps * TO_SUN_NED[1], down_surface_m)
