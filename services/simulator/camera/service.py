"""The camera: renders a picture of each scene that the simulator publishes, or projects the tags in it."""

from collections import deque
from collections.abc import Iterable
from functools import partial
from typing import Protocol

from jezero.base.arrays import Array
from jezero.base.camera_preview import PREVIEW_PERIOD_NS, preview_of
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.sensors import CameraFrame, TagCorners
from jezero.schemas.state import Scene
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.detections import NO_OBSTACLES, BoardGeometry, detect
from jezero.services.simulator.camera.gimbal import Gimbal
from jezero.services.simulator.camera.view import CameraView, view_of
from jezero.services.simulator.noise import generator

INFO_PERIOD_NS = NS_PER_S

SPEC = Spec(
    name="camera",
    inputs=(topics.SCENE, topics.CAMERA_PITCH, topics.SIMULATED_GIMBAL),
    outputs=(topics.CAMERA, topics.CAMERA_INFO, topics.CAMERA_PREVIEW, topics.TAG_CORNERS),
    triggers=(topics.SCENE.name,),
    rate_hz=100.0,
)


class NoEglError(RuntimeError):
    """There is no OpenGL on EGL; the message names the missing part."""


class Renderer(Protocol):
    """Makes pictures of the simulated world.

    Attributes:
        description: name of the renderer, for people.
        rate_max_hz: greatest number of pictures per second.
    """

    @property
    def description(self) -> str: ...
    @property
    def rate_max_hz(self) -> float: ...

    def picture(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> bytes:
        """Rows from the top, three bytes red, green, blue each.

        Args:
            views: views at the exposure's start, middle and end.
        """


class CameraSimulator:
    """Publishes one picture, or one list of tags, per exposure, with the delay of a real camera.

    Args:
        renderer: None in mode "projected".
        seed: seed of the noise.
        obstacles_ned_m: (n, 3, 3) corners of the triangles that may hide a tag in mode "projected", in the map.

    Attributes:
        description: name of the renderer, for people.
    """

    spec = SPEC

    def __init__(
        self,
        config: CameraConfig,
        vehicle: VehicleConfig,
        renderer: Renderer | None,
        seed: int,
        obstacles_ned_m: Array = NO_OBSTACLES,
    ) -> None:
        self._config = config
        self._obstacles_ned_m = obstacles_ned_m
        self._mount = vehicle.camera
        self._board = BoardGeometry(vehicle.platform.board)
        self._renderer = renderer
        self._rng = generator(seed, "camera")
        self._gimbal = Gimbal((vehicle.camera.pitch_rest_rad, vehicle.camera.roll_offset_rad), config.axis_rate_max_rps)
        self._waiting: deque[tuple[int, Publish]] = deque()
        self._epoch_id: int | None = None
        self._sequence = 0
        self._next_exposure_ns = 0
        self._next_info_ns = 0
        self._preview_period = -1
        """Number of the period, from time 0, whose preview is published."""
        self._described = False
        self.description = "projecting the tags" if renderer is None else renderer.description

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Expose a new scene; publish the pictures whose delay is over."""
        if not self._described:
            self._described = True
            yield Health("ok", self.description)
        self._gimbal.update(t_ns, inbox.new(topics.CAMERA_PITCH))
        self._gimbal.update(t_ns, inbox.new(topics.SIMULATED_GIMBAL))  # of the autopilot, when somebody controls it
        scenes = inbox.new(topics.SCENE)
        if scenes:
            self._expose(scenes[-1])
        while self._waiting and self._waiting[0][0] <= t_ns:
            exposed = self._waiting.popleft()[1]
            yield exposed
            if isinstance(exposed.message, CameraFrame):
                yield from self._preview(exposed.message)
        if t_ns >= self._next_info_ns or self._next_info_ns > t_ns + INFO_PERIOD_NS:
            self._next_info_ns = t_ns + INFO_PERIOD_NS
            yield Publish(topics.CAMERA_INFO, self._mount.info(t_ns))

    def _expose(self, scene: Scene) -> None:
        if scene.epoch_id != self._epoch_id:
            self._epoch_id = scene.epoch_id
            self._waiting.clear()
            self._next_exposure_ns = 0
        self._gimbal.move(scene.t_ns)
        period_ns = int(NS_PER_S / self._mount.rate_hz)
        if scene.t_ns < self._next_exposure_ns - period_ns // 10:
            return
        self._next_exposure_ns = max(self._next_exposure_ns + period_ns, scene.t_ns)
        views = self._views(scene)
        due_ns = scene.t_ns + int(self._config.delay_s * NS_PER_S)
        self._waiting.append((due_ns, self._take(scene, views)))

    def _preview(self, frame: CameraFrame) -> Iterable[Output]:
        """Publish the preview of the first frame of each period."""
        period = frame.t_ns // PREVIEW_PERIOD_NS
        if period != self._preview_period:
            self._preview_period = period
            yield Publish(topics.CAMERA_PREVIEW, preview_of(frame))

    def _views(self, scene: Scene) -> tuple[CameraView, CameraView, CameraView]:
        gimbal = self._gimbal
        view = partial(view_of, pos_camera_frd_m=self._mount.pos_camera_frd_m, turn_camera_rad=self._mount.turn_rad)
        axes_rad, rates_rps = (gimbal.pitch_rad, gimbal.roll_rad), (gimbal.pitch_rate_rps, gimbal.roll_rate_rps)
        half_s = 0.5 * self._config.exposure_s
        return (
            view(scene, axes_rad=axes_rad, rates_rps=rates_rps, ahead_s=-half_s),
            view(scene, axes_rad=axes_rad),
            view(scene, axes_rad=axes_rad, rates_rps=rates_rps, ahead_s=half_s),
        )

    def _take(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> Publish:
        config, pitch_rad, roll_rad = self._config, self._gimbal.pitch_rad, self._gimbal.roll_rad
        if self._renderer is None:
            info = self._mount.info(scene.t_ns)
            found = detect(self._board, views, info, config.projection, self._rng, self._obstacles_ned_m)
            corners = TagCorners(t_ns=scene.t_ns, pitch_camera_rad=pitch_rad, roll_camera_rad=roll_rad, tags=found)
            return Publish(topics.TAG_CORNERS, corners)
        self._sequence += 1
        frame = CameraFrame(
            t_ns=scene.t_ns,
            sequence=self._sequence,
            width_px=self._mount.width_px,
            height_px=self._mount.height_px,
            pitch_camera_rad=pitch_rad,
            roll_camera_rad=roll_rad,
            exposure_s=config.exposure_s,
            pixels=self._renderer.picture(scene, views),
        )
        return Publish(topics.CAMERA, frame)
