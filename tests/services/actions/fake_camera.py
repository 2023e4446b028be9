"""A camera with the sensors that belong to a picture, for tests of actions that take pictures."""

from collections import deque
from collections.abc import Iterator
from math import pi
from typing import Any

from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame, CameraInfo, Gnss, Imu
from jezero.schemas.struct import Message

SIDE_PX = 16
PERIOD_NS = 66_666_667
DELAY_NS = 100_000_000
PITCH_DOWN_RAD = -0.5 * pi


def frame(t_ns: int, sequence: int = 0, value: int = 7) -> CameraFrame:
    """A small picture of one colour."""
    return CameraFrame(
        t_ns=t_ns,
        sequence=sequence,
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        pitch_camera_rad=PITCH_DOWN_RAD,
        exposure_s=0.004,
        pixels=bytes([value]) * (3 * SIDE_PX * SIDE_PX),
    )


def info(t_ns: int) -> CameraInfo:
    """Intrinsics of that camera."""
    return CameraInfo(
        t_ns=t_ns,
        width_px=SIDE_PX,
        height_px=SIDE_PX,
        focal_px=10.0,
        center_px=(7.5, 7.5),
        pos_camera_frd_m=(0.0, 0.0, 0.03),
        rate_hz=15.0,
    )


def imu(t_ns: int) -> Imu:
    return Imu(t_ns=t_ns, acc_imu_frd_mps2=(0.0, 0.0, -9.81), gyro_imu_frd_rps=(0.0, 0.0, 0.0))


def gnss(t_ns: int) -> Gnss:
    return Gnss(
        t_ns=t_ns,
        position_deg=(45.0, 7.0, 300.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        std_horizontal_m=1.0,
        std_vertical_m=1.5,
        satellites=12,
    )


class FakeCamera:
    """Pictures, intrinsics, IMU and fixes, in virtual time.

    Attributes:
        mute: publishes no pictures.
    """

    def __init__(self) -> None:
        self.spec = Spec(
            name="camera",
            inputs=(topics.CAMERA_PITCH,),
            outputs=(topics.CAMERA, topics.CAMERA_INFO, topics.IMU, topics.GNSS),
            rate_hz=100.0,
        )
        self.mute = False
        self.pitches_rad: list[float] = []
        self._late: deque[CameraFrame] = deque()
        self._due: dict[str, int] = {}
        self._sequence = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        self.pitches_rad += [command.pitch_camera_rad for command in inbox.new(topics.CAMERA_PITCH)]
        if self._is_due("frame", t_ns, PERIOD_NS):
            self._sequence += 1
            self._late.append(frame(t_ns, self._sequence, self._sequence % 256))
        while self._late and self._late[0].t_ns + DELAY_NS <= t_ns:
            picture = self._late.popleft()
            if not self.mute:
                yield Publish(topics.CAMERA, picture)
        sensors: tuple[tuple[Topic[Any], Message, int], ...] = (
            (topics.CAMERA_INFO, info(t_ns), 1_000_000_000),
            (topics.IMU, imu(t_ns), 20_000_000),
            (topics.GNSS, gnss(t_ns), 100_000_000),
        )
        for topic, message, period_ns in sensors:
            if self._is_due(topic.name, t_ns, period_ns):
                yield Publish(topic, message)

    def _is_due(self, name: str, t_ns: int, period_ns: int) -> bool:
        if t_ns < self._due.get(name, 0):
            return False
        self._due[name] = t_ns + period_ns
        return True
