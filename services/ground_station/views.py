"""What the page shows of the vehicle, as plain values for the browser: instruments, poses, the robot, a landing.

No number is shown that is absent, late or not finite. Ages are seconds since a message arrived, None for one that never
did.
"""

import base64
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from math import degrees, hypot, isfinite, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from jezero.base.frames import Vec3, altitude_m, euler_from_quat, q_frd_from_camera
from jezero.base.vehicle_config import PlatformConfig, VehicleConfig
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.commands import CameraPitch
from jezero.schemas.estimate import Covariance6, Relative, RoverEstimate
from jezero.schemas.goals import LandFeedback
from jezero.schemas.landing_board import CELLS
from jezero.schemas.sensors import Altimeter, Gnss
from jezero.schemas.state import Status
from jezero.schemas.terrain import Ground
from jezero.services.ground_station.words import COMPASS, duration

ABSENT = "–"
LATE_S = 1.0
"""Age from which on a value is grey."""
LOST_S = 10.0
"""Age from which on a value is not shown any more."""
SIGMAS = 3.0
VAR_NORTH, VAR_EAST, VAR_DOWN = 0, 6, 11
"""Indices of the position's variances in the upper triangle of the covariance."""
POSITION_COVARIANCE = ((0, 1, 2), (1, 6, 7), (2, 7, 11))
"""Indices of the relative position's covariance in the upper triangle of that of position and velocity."""
LANDING_PHASES = {
    "approach": "Approach: flies to a point above the target",
    "descent": "Descent: goes down while it is inside the cone",
    "hold": "Hold: keeps its height, the platform is out of sight",
    "search": "Search: looks for the platform",
    "contact": "Contact: touches down, motors still on",
    "go_around": "Go-around: climbs after a bad contact",
}
LANDING_INPUTS = {"uwb": "UWB", "tag": "tags", "altimeter": "altimeter"}
PIXELS_PER_M = 1000
SIDE_MAX_PX = 2048
PANEL, EDGE, WHITE, BLACK = 205, 90, 245, 18
"""Grey values in the picture of the platform."""
EDGE_M = 0.012


# -- instruments: values with their ages, as text --


@dataclass(frozen=True)
class Reading:
    """One value of an instrument.

    Attributes:
        label: name of the value.
        text: the value, or `ABSENT`.
        unit: its unit; "" without a value.
        age: its age in words; "" for one that was never there.
        late: whether it is shown in grey.
    """

    label: str
    text: str
    unit: str
    age: str
    late: bool


def reading(label: str, value: float | None, unit: str, age_s: float | None, decimals: int = 1) -> Reading:
    """A reading of a number.

    Args:
        value: None when it is absent.
        age_s: None when it never arrived.
    """
    if value is None or age_s is None or not isfinite(value) or age_s > LOST_S:
        return Reading(label, ABSENT, "", "" if age_s is None else _age(age_s), True)
    text = f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0 makes 0.0 of -0.0
    return Reading(label, text, unit, _age(age_s), age_s > LATE_S)


def _age(age_s: float) -> str:
    return "now" if age_s <= LATE_S else f"{duration(age_s)} ago"


def flight_readings(status: Status | None, age_s: float | None, start_z_ned_m: float) -> list[Reading]:
    """Attitude, heights, speeds, battery and position.

    Args:
        status: newest status, with its odometry.
        age_s: age of the status.
        start_z_ned_m: z of the place from which the height is counted.
    """
    odometry = None if status is None else status.odometry
    battery = None if status is None else status.battery
    wind_mps = None if status is None else status.wind_ned_mps
    pos_m = vel_mps = None
    roll_deg = pitch_deg = heading_deg = None
    if odometry is not None:
        pos_m, vel_mps = odometry.pos_uav_ned_m, odometry.vel_uav_ned_mps
        if all(map(isfinite, odometry.q_ned_from_frd)):
            roll_deg, pitch_deg, yaw_deg = (degrees(angle) for angle in euler_from_quat(odometry.q_ned_from_frd))
            heading_deg = yaw_deg % 360.0
    height_m = None if pos_m is None else altitude_m(pos_m[2] - start_z_ned_m)
    remaining = None if battery is None else battery.remaining
    return [
        reading("heading", heading_deg, "°" if heading_deg is None else f"° {_compass_point(heading_deg)}", age_s, 0),
        reading("height", height_m, "m", age_s, 2),
        reading("speed", None if vel_mps is None else hypot(vel_mps[0], vel_mps[1]), "m/s", age_s),
        reading("climb", None if vel_mps is None else -vel_mps[2], "m/s", age_s),
        reading("battery", None if remaining is None else 100.0 * remaining, "%", age_s, 0),
        reading("north", None if pos_m is None else pos_m[0], "m", age_s, 2),
        reading("east", None if pos_m is None else pos_m[1], "m", age_s, 2),
        reading("position σ", None if odometry is None else odometry.std_pos_m, "m", age_s, 2),
        reading("roll", roll_deg, "°", age_s),
        reading("pitch", pitch_deg, "°", age_s),
        reading("voltage", None if battery is None else battery.voltage_v, "V", age_s),
        reading("wind", None if wind_mps is None else hypot(wind_mps[0], wind_mps[1]), "m/s", age_s),
    ]


def _compass_point(heading_deg: float) -> str:
    """The nearest of eight points of the compass."""
    return COMPASS[2 * round(heading_deg / 45.0) % 16]


def ground_reading(altimeter: Altimeter | None, age_s: float | None) -> Reading:
    """Height over the ground, by the altimeter."""
    return reading("over ground", None if altimeter is None else altimeter.range_m, "m", age_s, 2)


def gnss_readings(gnss: Gnss | None, age_s: float | None) -> list[Reading]:
    """Quality of the GNSS fix."""
    return [
        reading("satellites", None if gnss is None else gnss.satellites, "", age_s, 0),
        reading("GNSS σ", None if gnss is None else gnss.std_horizontal_m, "m", age_s, 2),
        reading("GNSS σ up", None if gnss is None else gnss.std_vertical_m, "m", age_s, 2),
        reading("GNSS speed", None if gnss is None else hypot(*gnss.vel_uav_ned_mps[:2]), "m/s", age_s),
    ]


def rover_readings(
    relative: Relative | None, relative_age_s: float | None, rover: RoverEstimate | None, rover_age_s: float | None
) -> list[Reading]:
    """Distance to the rover and what the estimate is worth; nothing of an estimate that is invalid."""
    valid = relative if relative is not None and relative.valid else None
    rel_m = None if valid is None else valid.pos_uav_rel_rover_ned_m
    std_m = None if valid is None else sqrt(max(valid.cov[VAR_NORTH], valid.cov[VAR_EAST], 0.0))
    speed_mps = None
    if rover is not None and rover.valid:
        speed_mps = hypot(rover.vel_rover_ned_mps[0], rover.vel_rover_ned_mps[1])
    return [
        reading("to the rover", None if rel_m is None else hypot(rel_m[0], rel_m[1]), "m", relative_age_s, 2),
        reading("over rover", None if rel_m is None else altitude_m(rel_m[2]), "m", relative_age_s, 2),
        reading("estimate 3σ", None if std_m is None else SIGMAS * std_m, "m", relative_age_s, 2),
        reading("rover speed", speed_mps, "m/s", rover_age_s),
    ]


# -- what the 3D view and the map draw, in the world frame NED --


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
    matrix = np.array([[cov[index] for index in row] for row in POSITION_COVARIANCE])
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
        "obstacles": [
            {
                "colour": list(obstacle.colour),
                "corners": [number for corner in obstacle.pos_corners_ned_m for number in corner],
                "triangles": [index for triangle in obstacle.triangles for index in triangle],
            }
            for obstacle in ground.obstacles
        ],
    }


def rounded(vector: Iterable[float]) -> list[float]:
    """A vector to the millimetre."""
    return [round(part, 3) for part in vector]


def _finite(vector: Iterable[float]) -> bool:
    return all(map(isfinite, vector))


# -- the robot, from `vehicle.toml` --


def robot_shapes(vehicle: VehicleConfig) -> dict[str, Any]:
    """Sizes of vehicle, camera and platform, in metres, in the axes frd and rover_body."""
    camera, airframe, platform = vehicle.camera, vehicle.airframe, vehicle.platform
    tan_right = 0.5 * camera.width_px / camera.focal_px
    return {
        "stand": airframe.height_stand_m,
        "altimeter": vehicle.height_altimeter_m,
        "rotors": [list(pos_m) for pos_m in airframe.pos_rotors_frd_m],
        "radius": airframe.radius_rotor_m,
        "feet": list(airframe.feet_frd_m),
        "camera": {
            "pos": list(camera.pos_camera_frd_m),
            "q_rest": list(q_frd_from_camera(camera.pitch_rest_rad, camera.roll_offset_rad)),
            "turn": camera.turn_rad,
            "tan_right": tan_right,
            "tan_down": 0.5 * camera.height_px / (camera.aspect * camera.focal_px),
        },
        "platform": {
            "side": platform.side_m,
            "height": platform.height_m,
            "picture": board_address(platform),
        },
    }


def board_address(platform: PlatformConfig) -> str:
    """The picture as a PNG in a `data:` address."""
    import cv2

    _, compressed = cv2.imencode(".png", board_picture(platform))
    return "data:image/png;base64," + base64.b64encode(compressed.tobytes()).decode()


def board_picture(platform: PlatformConfig) -> npt.NDArray[np.uint8]:
    """(n, n) grey; rows from the rover's nose, columns from its left."""
    px_per_m = min(PIXELS_PER_M, SIDE_MAX_PX / platform.side_m)
    n = round(platform.side_m * px_per_m)
    picture = np.full((n, n), EDGE, dtype=np.uint8)
    edge = round(EDGE_M * px_per_m)
    picture[edge : n - edge, edge : n - edge] = PANEL
    for tag in platform.board:
        forward_m, right_m, _ = tag.pos_rover_body_m
        middle_m = (0.5 * platform.side_m - forward_m, 0.5 * platform.side_m + right_m)
        _print_tag(picture, tag.tag_id, tag.side_m * px_per_m, (middle_m[0] * px_per_m, middle_m[1] * px_per_m))
    return picture


def _print_tag(picture: npt.NDArray[np.uint8], tag_id: int, side_px: float, middle_px: tuple[float, float]) -> None:
    """Print a tag with its white margin of one cell; pixels outside the picture are left out."""
    import cv2

    dictionary: Any = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.pad(cv2.aruco.generateImageMarker(dictionary, tag_id, CELLS), 1, constant_values=255)
    outer_px = side_px * len(cells) / CELLS
    rows, columns = (_cells_at(len(picture), middle - 0.5 * outer_px, outer_px, len(cells)) for middle in middle_px)
    printed = np.where(cells > 0, WHITE, BLACK).astype(np.uint8)
    inside = np.ix_(np.flatnonzero(rows >= 0), np.flatnonzero(columns >= 0))
    picture[inside] = printed[np.ix_(rows[rows >= 0], columns[columns >= 0])]


def _cells_at(pixels: int, start_px: float, outer_px: float, cells: int) -> npt.NDArray[np.int64]:
    """(pixels,) number of the cell in which the middle of each pixel is; -1 outside the tag."""
    at = np.floor((np.arange(pixels) + 0.5 - start_px) / outer_px * cells).astype(np.int64)
    return np.where((at >= 0) & (at < cells), at, -1)


# -- the target view of a landing --


def landing_view(
    message: FeedbackMessage[Any] | None, age_s: float | None, relative: Relative | None, relative_age_s: float | None
) -> dict[str, Any] | None:
    """What the target view shows; None without a landing.

    Args:
        message: newest feedback of the goal in charge.
        age_s: age of the feedback; None when it never arrived.
        relative: newest relative estimate.
    """
    feedback = None if message is None else message.feedback
    if not isinstance(feedback, LandFeedback) or age_s is None:
        return None
    asked_for = relative is not None and message is not None and relative.goal_id == message.goal_id
    on_platform = asked_for or feedback.cone_m is not None
    fresh = relative is not None and relative_age_s is not None and relative_age_s <= LATE_S
    estimate = relative if fresh and on_platform and relative is not None and relative.valid else None
    pos_m = feedback.pos_rel_ned_m if estimate is None else estimate.pos_uav_rel_rover_ned_m
    pos_age_s = age_s if estimate is None else relative_age_s
    shown = pos_m if pos_m is not None and all(map(isfinite, pos_m)) else None
    late = age_s > LATE_S
    return {
        "phase": "No news of the landing" if late else LANDING_PHASES[feedback.phase],
        "late": late,
        "platform": on_platform,
        "cone": feedback.cone_m,
        "pos": None if shown is None or (pos_age_s or 0.0) > LATE_S else rounded(shown),
        "axes": None if estimate is None else ellipsoid(estimate.cov),
        "yaw": None if estimate is None else round(estimate.yaw_rover_rad, 3),
        "inputs": _landing_inputs(relative if fresh else None) if on_platform else [],
        "verdict": _landing_verdict(relative, relative_age_s, fresh, on_platform),
        "rows": [asdict(row) for row in _landing_rows(shown, pos_age_s, estimate, relative_age_s)],
    }


def _landing_rows(
    pos_m: Vec3 | None, pos_age_s: float | None, estimate: Relative | None, estimate_age_s: float | None
) -> list[Reading]:
    std_m = std_down_m = None
    if estimate is not None:
        std_m = sqrt(max(estimate.cov[VAR_NORTH], estimate.cov[VAR_EAST], 0.0))
        std_down_m = sqrt(max(estimate.cov[VAR_DOWN], 0.0))
    aside_m = None if pos_m is None else hypot(pos_m[0], pos_m[1])
    return [
        reading("beside the middle", aside_m, "m", pos_age_s, 2),
        reading("± 3σ", None if std_m is None else SIGMAS * std_m, "m", estimate_age_s, 2),
        reading("height", None if pos_m is None else altitude_m(pos_m[2]), "m", pos_age_s, 2),
        reading("± 3σ height", None if std_down_m is None else SIGMAS * std_down_m, "m", estimate_age_s, 2),
    ]


def _landing_inputs(relative: Relative | None) -> list[dict[str, Any]]:
    """Each input of the relative position, and whether it was fused in the last second."""
    used = () if relative is None else relative.inputs
    wanted = {"uwb": relative is not None and relative.use_uwb, "tag": relative is not None and relative.use_tag}
    return [
        {"name": words, "state": "used" if name in used else "silent" if wanted.get(name) else "off"}
        for name, words in LANDING_INPUTS.items()
    ]


def _landing_verdict(relative: Relative | None, age_s: float | None, fresh: bool, on_platform: bool) -> dict[str, str]:
    if not on_platform:
        return {"tone": "plain", "text": "by the vehicle's own position, without the rover"}
    if relative is None or age_s is None:
        return {"tone": "bad", "text": "no estimate of the rover arrives"}
    if not fresh:
        return {"tone": "bad", "text": "the estimator is silent"}
    if not relative.valid:
        return {"tone": "bad", "text": f"estimate invalid: {relative.reason}"}
    return {"tone": "good", "text": "estimate valid"}
