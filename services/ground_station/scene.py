"""What the views draw, as plain numbers for the browser: poses, ellipsoids, ground. Nothing that is not finite."""

from collections.abc import Iterable
from math import degrees, isfinite
from typing import Any

import numpy as np

from jezero.frames import euler_from_quat, q_frd_from_camera
from jezero.schemas.commands import CameraPitch
from jezero.schemas.estimate import Covariance6, Relative, RoverEstimate
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Status
from jezero.schemas.terrain import Ground
from jezero.services.ground_station.readings import LATE_S, LOST_S

SIGMAS = 3.0
POSITION = ((0, 1, 2), (1, 6, 7), (2, 7, 11))
"""Indices of the relative position's covariance in the upper triangle of that of position and velocity."""


def vehicle_pose(status: Status | None, age_s: float | None) -> dict[str, Any] | None:
    """The vehicle in the world frame; None when it is lost, or not known as a whole."""
    odometry = None if status is None else status.odometry
    if status is None or odometry is None or age_s is None or age_s >= LOST_S:
        return None
    vectors = (odometry.pos_uav_ned_m, odometry.vel_uav_ned_mps, odometry.q_ned_from_frd)
    if not all(map(_finite, vectors)):
        return None
    roll_deg, pitch_deg, yaw_deg = (degrees(angle) for angle in euler_from_quat(odometry.q_ned_from_frd))
    return {
        "pos": rounded(odometry.pos_uav_ned_m), "vel": rounded(odometry.vel_uav_ned_mps),
        "q": [round(part, 4) for part in odometry.q_ned_from_frd],
        "roll": round(roll_deg, 1), "pitch": round(pitch_deg, 1), "yaw": round(yaw_deg, 1),
        "armed": status.armed, "landed": status.landed, "late": age_s > LATE_S,
    }  # fmt: skip


def altimeter_range(altimeter: Altimeter | None, age_s: float | None) -> float | None:
    """Range of the altimeter in metres; None without a fresh one."""
    if altimeter is None or age_s is None or age_s > LATE_S or altimeter.range_m is None:
        return None
    return round(altimeter.range_m, 3) if isfinite(altimeter.range_m) else None


def rover_pose(rover: RoverEstimate | None, age_s: float | None) -> dict[str, Any] | None:
    """The rover's platform in the world frame; None without a valid estimate."""
    if rover is None or age_s is None or not rover.valid or age_s > LOST_S:
        return None
    if not _finite((*rover.pos_rover_ned_m, rover.yaw_rover_rad)):
        return None
    return {"pos": rounded(rover.pos_rover_ned_m), "yaw": round(rover.yaw_rover_rad, 3), "late": age_s > LATE_S}


def relative_ellipsoid(relative: Relative | None, age_s: float | None) -> list[list[float]] | None:
    """Half axes of 3 standard deviations of the position relative to the rover, as three vectors in NED."""
    if relative is None or not relative.valid or age_s is None or age_s > LATE_S:
        return None
    return ellipsoid(relative.cov)


def ellipsoid(cov: Covariance6) -> list[list[float]] | None:
    """Half axes of 3 standard deviations of the position; None for a covariance that is none."""
    matrix = np.array([[cov[index] for index in row] for row in POSITION])
    if not np.isfinite(matrix).all():
        return None
    variances, axes = np.linalg.eigh(matrix)
    if variances[0] < -1e-9:
        return None
    halves: list[list[float]] = np.round(SIGMAS * np.sqrt(np.maximum(variances, 0.0)) * axes, 4).T.tolist()
    return halves


def camera_attitude(angles: CameraPitch | None, age_s: float | None) -> list[float] | None:
    """Quaternion [w, x, y, z] from the camera's axes (right, down, forward) to frd; None when nobody turns it."""
    if angles is None or age_s is None or age_s > LATE_S:
        return None
    return [round(part, 4) for part in q_frd_from_camera(angles.pitch_camera_rad, angles.roll_camera_rad)]


def ground_shape(ground: Ground | None) -> dict[str, Any] | None:
    """The ground for the browser, with its heights in one list; None without a simulator."""
    if ground is None or not ground.heights_mm:
        return None
    return {
        "spacing": ground.spacing_m,
        "corner": list(ground.corner_ned_m),
        "columns": len(ground.heights_mm[0]),
        "heights_mm": [height for row in ground.heights_mm for height in row],
        "rocks": [[*rock.pos_rock_ned_m, rock.radius_m] for rock in ground.rocks],
    }


def rounded(vector: Iterable[float]) -> list[float]:
    """A vector to the millimetre."""
    return [round(part, 3) for part in vector]


def _finite(vector: Iterable[float]) -> bool:
    return all(map(isfinite, vector))
