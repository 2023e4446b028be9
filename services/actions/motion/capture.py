"""Pictures at planned points, each with the measurements at its exposure. No I/O: the goal's run feeds it.

The planner of an action that takes pictures makes one `Capture` for each plan, puts it into the plan and hands it to
the behaviour; the action is declared with `takes_pictures=True` and reports `ImagesFeedback`. The goal's run then
subscribes to `CAPTURE_INPUTS` too, calls `update` once per step and stores the pictures on disk; the flight fills
`taken`, `planned` and `images` of the feedback, and aborts the goal with `problem`; the server replies with the pixels
on the action's `image` endpoint. The planner

- calls `capture.refusal()` in the plan's `check_inputs`: no goal is accepted while the camera sends nothing.

The behaviour

- calls `capture.request(index, t_ns)` in the `step` in which the vehicle passes planned point `index`: its picture is
  the first one that is exposed at `t_ns` or later, and one picture serves one point. Pictures arrive 0.1 s and more
  after their exposure: `capture.is_waiting` is true until all requested ones have come;
- may aim with `capture.pos_camera`;
- reads `capture.taken`, and returns `capture.images()` in its result: all so far, in the present world frame.
"""

from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

import msgspec

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    geodetic_from_ned,
    q_frd_from_camera,
    quat_between,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    scale,
    subtract,
    yaw_from_quat,
)
from jezero.base.vehicle_config import AirframeConfig
from jezero.runtime.service import Inbox
from jezero.schemas.images import Image, ImageReply
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame, CameraInfo
from jezero.schemas.state import Odometry
from jezero.schemas.struct import Message
from jezero.schemas.topics import ALTIMETER, CAMERA, CAMERA_INFO, GNSS, IMU, ODOMETRY
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.config import CaptureConfig

AHEAD_MAX_NS = 50_000_000
"""Messages that seem to come from farther in the future are dropped."""
GAP_MAX_NS = 250_000_000
"""There is no interpolation between two odometries with a longer gap."""
HISTORY_S = 2.0
"""Measurements are kept for this duration, to be there when the picture comes; older pictures are dropped."""
SENSOR_AGE_MAX_S = 0.3
"""A measurement belongs to a picture when it was made at most this before or after the exposure."""
FRAMES_WAITING = 3
SENSORS: tuple[Topic[Any], ...] = (IMU, GNSS, ALTIMETER)
CAPTURE_INPUTS: tuple[Topic[Any], ...] = (CAMERA, CAMERA_INFO, *SENSORS)
M = TypeVar("M", bound=Message)


class Shot(NamedTuple):
    """A picture with its pixels."""

    image: Image
    frame: CameraFrame

    def reply(self, goal_id: str) -> ImageReply:
        """The server's reply to a request for this picture."""
        width_px, height_px, pixels = self.frame.width_px, self.frame.height_px, self.frame.pixels
        index = self.image.index
        return ImageReply(goal_id=goal_id, index=index, width_px=width_px, height_px=height_px, pixels=pixels)


class _Record(NamedTuple):
    image: Image
    offset_ned_m: Vec3
    """Sum of the autopilot's position steps at the exposure."""


class Capture:
    """The pictures of one goal.

    Args:
        stream: whether feedback reports each picture as it is taken.

    Attributes:
        planned: number of pictures that there will be.
        behind_ns: vehicle time minus the goal's own time, in which requests are made; the goal's flight sets it.
    """

    def __init__(self, config: CaptureConfig, airframe: AirframeConfig, planned: int, *, stream: bool = True) -> None:
        self.planned = planned
        self.behind_ns = 0
        self._config = config
        self._height_stand_m = airframe.height_stand_m
        self._stream = stream
        self._records: list[_Record] = []
        self._reported = 0
        self._requested: deque[tuple[int, int]] = deque()
        """Index and time of each request without a picture, oldest first."""
        self._frames: deque[CameraFrame] = deque(maxlen=FRAMES_WAITING)
        self._info: CameraInfo | None = None
        self._origin_deg: Vec3 | None = None
        self._offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._odometry: deque[Odometry] = deque()
        self._sensed: dict[str, deque[Any]] = {topic.name: deque() for topic in SENSORS}
        self._frame_ns: int | None = None
        """Time of exposure of the newest frame."""
        self._failure = ""

    # -- for the behaviour --

    @property
    def taken(self) -> int:
        """Number of pictures so far."""
        return len(self._records)

    @property
    def is_waiting(self) -> bool:
        """Whether a point was passed whose picture hasn't come yet."""
        return bool(self._requested)

    def request(self, index: int, t_ns: int) -> None:
        """Request the picture of a planned point that the vehicle passes at a time of the goal's own."""
        self._requested.append((index, t_ns + self.behind_ns))

    def pos_camera(self, pos_uav_ned_m: Vec3, q_ned_from_frd: Quat) -> Vec3:
        """Position of the optical centre of a vehicle with this pose."""
        arm_frd_m = (0.0, 0.0, 0.0) if self._info is None else self._info.pos_camera_frd_m
        north_m, east_m, down_m = add(pos_uav_ned_m, quat_rotate(q_ned_from_frd, arm_frd_m))
        return (north_m, east_m, down_m - self._height_stand_m)

    def refusal(self) -> str:
        """Reason why no goal can begin, or ""; to be called when the inputs have had time to come."""
        if self._frame_ns is not None and self._info is not None:
            return ""
        if self._info is not None:
            return 'no pictures: the camera only projects tags; set mode = "rendered" in camera.toml'
        problem = "sends none" if self._frame_ns is None else "doesn't publish its intrinsics"
        return f"no pictures: the camera {problem}: see `jezero ps`"

    def problem(self, t_ns: int) -> str:
        """Reason why the goal must be aborted, or ""."""
        if self._failure:
            return self._failure
        late_s = (t_ns - self._requested[0][1]) / NS_PER_S if self._requested else 0.0
        if late_s <= self._config.late_max_s:
            return ""
        return f"no pictures: none came for point {self._requested[0][0] + 1} of {self.planned} within {late_s:.1f} s"

    def images(self) -> tuple[Image, ...]:
        """All images so far, in the present world frame."""
        return tuple(self._moved(record) for record in self._records)

    # -- for the goal's run --

    def fail(self, reason: str) -> None:
        """Make the goal fail because its pictures can't be stored."""
        self._failure = f"no pictures: {reason}"

    def unreported_images(self) -> tuple[Image, ...]:
        """Images that no feedback has reported yet; none if they are not streamed."""
        if not self._stream:
            return ()
        news = tuple(self._moved(record) for record in self._records[self._reported :])
        self._reported = len(self._records)
        return news

    def update(self, t_ns: int, inbox: Inbox) -> Iterator[Shot]:
        """Store the measurements that arrived; yields the requested pictures among them."""
        for odometry in inbox.new(ODOMETRY):
            if not self._odometry or odometry.t_ns > self._odometry[-1].t_ns:
                self._keep(t_ns, self._odometry, odometry)
        for topic in SENSORS:
            for message in inbox.new(topic):
                self._keep(t_ns, self._sensed[topic.name], message)
        self._info = inbox.latest(CAMERA_INFO) or self._info
        if self._odometry:
            newest = self._odometry[-1]
            self._origin_deg, self._offset_ned_m = newest.origin_deg, newest.reset_offset_ned_m
        for frame in inbox.new(CAMERA):
            if self._is_current(t_ns, frame) and frame.t_ns > (self._frame_ns or -1):
                self._frame_ns = frame.t_ns
                self._frames.append(frame)
        yield from self._serve()

    def _serve(self) -> Iterator[Shot]:
        """Match each frame with the oldest request, once the odometry after its exposure is there."""
        while self._frames and self._odometry and self._frames[0].t_ns <= self._odometry[-1].t_ns:
            frame = self._frames.popleft()
            if not self._requested or frame.t_ns < self._requested[0][1] or self._info is None:
                continue
            at = self._vehicle_at(frame.t_ns)
            if at is None:
                continue
            record = self._record(self._requested[0][0], frame, at, self._info)
            self._requested.popleft()
            self._records.append(record)
            yield Shot(record.image, frame)

    def _keep(self, t_ns: int, kept: deque[M], message: M) -> None:
        if not self._is_current(t_ns, message):
            return
        kept.append(message)
        while kept[0].t_ns < t_ns - HISTORY_S * NS_PER_S:
            kept.popleft()

    def _is_current(self, t_ns: int, message: Message) -> bool:
        return -AHEAD_MAX_NS <= t_ns - message.t_ns <= HISTORY_S * NS_PER_S

    # -- measurements at an exposure --

    def _vehicle_at(self, t_ns: int) -> Odometry | None:
        """Odometry at a time, interpolated; None when its neighbours are too far apart or too far back."""
        for before, after in zip(reversed([*self._odometry][:-1]), reversed(self._odometry), strict=False):
            if before.t_ns > t_ns:
                continue
            span_ns = after.t_ns - before.t_ns
            if span_ns > GAP_MAX_NS:
                return None
            fraction = (t_ns - before.t_ns) / span_ns
            step = subtract(after.reset_offset_ned_m, before.reset_offset_ned_m)
            way = subtract(subtract(after.pos_uav_ned_m, step), before.pos_uav_ned_m)
            pos_uav_ned_m = add(before.pos_uav_ned_m, scale(way, fraction))
            q_ned_from_frd = quat_between(before.q_ned_from_frd, after.q_ned_from_frd, fraction)
            return msgspec.structs.replace(before, pos_uav_ned_m=pos_uav_ned_m, q_ned_from_frd=q_ned_from_frd)
        return None

    def _record(self, index: int, frame: CameraFrame, at: Odometry, info: CameraInfo) -> _Record:
        q_ned_from_camera = quat_multiply(
            at.q_ned_from_frd, q_frd_from_camera(frame.pitch_camera_rad, frame.roll_camera_rad, info.turn_camera_rad)
        )
        pos_camera_ned_m = self.pos_camera(at.pos_uav_ned_m, at.q_ned_from_frd)
        altimeter = self._nearest(ALTIMETER, frame.t_ns)
        reduced, (center_x_px, center_y_px) = frame.width_px / info.width_px, info.center_px
        image = Image(
            index=index,
            t_ns=frame.t_ns,
            pos_uav_ned_m=_rounded(at.pos_uav_ned_m, 5),
            q_ned_from_frd=_rounded(at.q_ned_from_frd, 7),
            yaw_rad=round(yaw_from_quat(at.q_ned_from_frd), 6),
            pos_camera_ned_m=_rounded(pos_camera_ned_m, 5),
            q_ned_from_camera=_rounded(quat_normalize(q_ned_from_camera), 7),
            position_camera_deg=self._on_globe(pos_camera_ned_m),
            pitch_camera_rad=frame.pitch_camera_rad,
            roll_camera_rad=frame.roll_camera_rad,
            exposure_s=frame.exposure_s,
            width_px=frame.width_px,
            height_px=frame.height_px,
            focal_px=reduced * info.focal_px,
            center_px=(reduced * (center_x_px + 0.5) - 0.5, reduced * (center_y_px + 0.5) - 0.5),
            distortion=info.distortion,
            focal_y_px=msgspec.UNSET if info.focal_y_px is msgspec.UNSET else reduced * info.focal_y_px,
            range_m=None if altimeter is None else altimeter.range_m,
            imu=self._nearest(IMU, frame.t_ns),
            gnss=self._nearest(GNSS, frame.t_ns),
        )
        return _Record(image, at.reset_offset_ned_m)

    def _nearest(self, topic: Topic[M], t_ns: int) -> M | None:
        """The message of the topic that is nearest in time, unless it is too far away."""
        kept: deque[M] = self._sensed[topic.name]
        nearest = min(kept, key=lambda message: abs(message.t_ns - t_ns), default=None)
        far_ns = SENSOR_AGE_MAX_S * NS_PER_S
        return nearest if nearest is not None and abs(nearest.t_ns - t_ns) <= far_ns else None

    def _on_globe(self, pos_ned_m: Vec3) -> Vec3 | None:
        if self._origin_deg is None:
            return None
        latitude, longitude, altitude = geodetic_from_ned(pos_ned_m, self._origin_deg)
        return (round(latitude, 10), round(longitude, 10), round(altitude, 4))

    def _moved(self, record: _Record) -> Image:
        """Image of a record in the present world frame."""
        step = subtract(self._offset_ned_m, record.offset_ned_m)
        if not any(step):
            return record.image
        pos_camera_ned_m = add(record.image.pos_camera_ned_m, step)
        return msgspec.structs.replace(
            record.image,
            pos_uav_ned_m=add(record.image.pos_uav_ned_m, step),
            pos_camera_ned_m=pos_camera_ned_m,
            position_camera_deg=self._on_globe(pos_camera_ned_m),
        )


def _rounded(numbers: Any, digits: int) -> Any:
    return tuple(round(number, digits) for number in numbers)
