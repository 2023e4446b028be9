"""Camera with small grey images, which cost nothing, and with true pointing and times."""

from collections.abc import Iterator

from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.sensors import CameraFrame
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.gimbal import Gimbal
from jezero.vehicle_config import CameraMountConfig

NAME = "blank_camera"
RATE_HZ = 5.0
WIDTH_PX, HEIGHT_PX = 16, 12
GREY = bytes([128]) * (3 * WIDTH_PX * HEIGHT_PX)


class BlankCamera:
    """Publishes grey images of a few pixels.

    Args:
        config: the camera's settings.
        publishes_info: whether to publish `camera/info` too, where no other camera does.
    """

    def __init__(self, config: CameraConfig, mount: CameraMountConfig, *, publishes_info: bool) -> None:
        self.spec = Spec(
            name=NAME,
            inputs=(topics.CAMERA_PITCH,),
            outputs=(topics.CAMERA, topics.CAMERA_INFO),
            rate_hz=RATE_HZ,
        )
        self._config = config
        self._mount = mount
        self._gimbal = Gimbal((mount.pitch_rest_rad, mount.roll_offset_rad), config.axis_rate_max_rps)
        self._publishes_info = publishes_info
        self._sequence = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Publish one image."""
        self._gimbal.update(t_ns, inbox.new(topics.CAMERA_PITCH))
        self._gimbal.move(t_ns)
        self._sequence += 1
        frame = CameraFrame(
            t_ns=t_ns,
            sequence=self._sequence,
            width_px=WIDTH_PX,
            height_px=HEIGHT_PX,
            pitch_camera_rad=self._gimbal.pitch_rad,
            roll_camera_rad=self._gimbal.roll_rad,
            exposure_s=self._config.exposure_s,
            pixels=GREY,
        )
        yield Publish(topics.CAMERA, frame)
        if self._publishes_info:
            yield Publish(topics.CAMERA_INFO, self._mount.info(t_ns))
