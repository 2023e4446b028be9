"""The tag detector: estimates the relative position from the newest picture."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.estimate import TagEstimate
from jezero.schemas.landing_board import BoardTag
from jezero.schemas.sensors import CameraFrame, CornersOfTag, TagCorners
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.attitude_history import AttitudeHistory
from jezero.services.estimator.rover_tilt import LEVEL, level_from_rover_body
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.pose import TagPose, TagView, make_view, solve

if TYPE_CHECKING:
    from jezero.services.estimator.tag_detector.finder import Finder

ATTITUDE_AGE_MAX_S = 0.06
"""An exposure may be this far from the nearest known attitude."""
SILENT_S = 2.0
"""After this time without pictures, or without a tag in them, health says so."""

SPEC = Spec(
    name="tag_detector",
    inputs=(topics.CAMERA, topics.CAMERA_INFO, topics.TAG_CORNERS, topics.ODOMETRY, topics.ROVER_ODOMETRY),
    outputs=(topics.ESTIMATE_TAG,),
    triggers=(topics.CAMERA.name, topics.TAG_CORNERS.name),
    rate_hz=5.0,
)


class TagDetector:
    """Uses the tags of the vehicle's board, and the vehicle's attitude at the exposure."""

    def __init__(self, config: TagDetectorConfig, vehicle: VehicleConfig) -> None:
        self.spec = replace(SPEC, made_with={"config": config, "vehicle": vehicle})
        self._config = config
        self._corners_m = corners_by_id(vehicle.platform.board)
        self._finder: Finder | None = None
        self._attitudes = AttitudeHistory(ATTITUDE_AGE_MAX_S)
        self._found_ns = -NS_PER_S
        self._picture_ns = -NS_PER_S
        self._health = ""

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publish the estimate from the newest picture, if there is a new one."""
        for odometry in inbox.new(topics.ODOMETRY):
            self._attitudes.add(odometry)
        frames, corners = inbox.new(topics.CAMERA), inbox.new(topics.TAG_CORNERS)
        if frames:
            frame = frames[-1]
            yield from self._estimate(t_ns, frame, self._find(frame), inbox)
        elif corners:
            newest = corners[-1]
            yield from self._estimate(t_ns, newest, newest.tags, inbox)
        yield from self._publish_health(t_ns, inbox)

    def _find(self, frame: CameraFrame) -> tuple[CornersOfTag, ...]:
        """Tags in a picture; the first picture loads the libraries, which flights with projected tags don't need."""
        from jezero.services.estimator.tag_detector.finder import Finder

        if self._finder is None:
            self._finder = Finder(self._config)
        return self._finder.find(frame)

    def _estimate(
        self, t_ns: int, exposed: CameraFrame | TagCorners, tags: Sequence[CornersOfTag], inbox: Inbox
    ) -> Iterable[Output]:
        self._picture_ns = t_ns
        info, q_ned_from_frd = inbox.latest(topics.CAMERA_INFO), self._attitudes.at(exposed.t_ns)
        if info is None or q_ned_from_frd is None:
            return
        pitch_rad, roll_rad = exposed.pitch_camera_rad, exposed.roll_camera_rad
        view = make_view(info, pitch_rad, q_ned_from_frd, roll_rad)
        rover = inbox.latest(topics.ROVER_ODOMETRY)
        tilt = LEVEL if rover is None else level_from_rover_body(rover)
        corners_level_m = {tag_id: corners_m @ tilt.T for tag_id, corners_m in self._corners_m.items()}
        solution = locate(tags, corners_level_m, view, self._config)
        if solution is None:
            return
        self._found_ns = t_ns
        yield Publish(topics.ESTIMATE_TAG, _message(exposed.t_ns, solution, view, self._config))

    def _publish_health(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        if t_ns - self._picture_ns > SILENT_S * NS_PER_S:
            text = "no pictures: is the camera running?"
        elif inbox.latest(topics.CAMERA_INFO) is None:
            text = "no camera/info: the pictures can't be measured"
        elif t_ns - self._found_ns > SILENT_S * NS_PER_S:
            text = "pictures, but no landing tag in view"
        else:
            text = "sees the landing board"
        if text != self._health:
            self._health = text
            yield Health("degraded" if text.startswith("no ") else "ok", text)


def corners_by_id(board: Sequence[BoardTag]) -> dict[int, Array]:
    """(4, 3) corners of each tag in rover_body, by the tag's id."""
    return {tag.tag_id: np.array(tag.corners_rover_body_m) for tag in board}


def locate(
    tags: Sequence[CornersOfTag], corners_m: Mapping[int, Array], view: TagView, config: TagDetectorConfig
) -> tuple[tuple[int, ...], TagPose] | None:
    """Ids of the tags that fit one pose, and this pose; tags of other boards are ignored.

    When the corners don't fit one pose, the tag that fits worst is left out, until they do.

    Args:
        corners_m: (4, 3) corners of each tag relative to the platform, in level axes with the rover's heading, by the
            tag's id.
    """
    ideal_px = {tag.tag_id: view.ideal_px(np.array(tag.corners_px)) for tag in tags if tag.tag_id in corners_m}
    known = [tag for tag in tags if tag.tag_id in ideal_px and np.isfinite(ideal_px[tag.tag_id]).all()]
    while known:
        points_m = np.concatenate([corners_m[tag.tag_id] for tag in known])
        corners_px = np.concatenate([ideal_px[tag.tag_id] for tag in known])
        pose = solve(points_m, corners_px, view)
        if pose is not None and _rms(pose.residuals_px) <= config.reprojection_max_px:
            return tuple(tag.tag_id for tag in known), pose
        if pose is None or len(known) == 1:
            return None
        worst = int(np.argmax([_rms(pose.residuals_px[4 * i : 4 * i + 4]) for i in range(len(known))]))
        del known[worst]
    return None


def _rms(residuals_px: Array) -> float:
    return sqrt(float(np.mean(np.sum(residuals_px**2, axis=1))))


def _message(
    exposed_ns: int, solution: tuple[tuple[int, ...], TagPose], view: TagView, config: TagDetectorConfig
) -> TagEstimate:
    tag_ids, pose = solution
    pos_camera_m = pose.pos_uav_rel_rover_ned_m + view.pos_camera_uav_ned_m
    range_m = float(np.linalg.norm(pos_camera_m))
    cov = config.std_corner_px**2 * pose.inverse_normal
    common_m = config.std_common_px / view.focal_px * range_m
    cov[:3, :3] += common_m**2 * np.eye(3)
    n, e, d = (float(value) for value in pose.pos_uav_rel_rover_ned_m)
    pos_uav_rel_rover_ned_m: Vec3 = (n, e, d)
    return TagEstimate(
        t_ns=exposed_ns,
        tag_ids=tag_ids[:8],
        pos_uav_rel_rover_ned_m=pos_uav_rel_rover_ned_m,
        cov_pos_ned_m2=tuple(float(cov[i, j]) for i in range(3) for j in range(i, 3)),  # type: ignore[arg-type]
        range_m=range_m,
        yaw_rover_rad=max(-pi, min(pi, pose.yaw_rover_rad)),
        std_yaw_rover_rad=sqrt(float(cov[3, 3])),
        reprojection_px=_rms(pose.residuals_px),
    )
