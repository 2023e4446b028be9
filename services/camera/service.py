"""The driver of a real camera: it publishes what its link brings, as the simulated camera does.

A fixed camera is turned by nothing, so commands of its pitch change nothing. One on a gimbal is turned by the bridge,
which publishes the measured angles: a picture has those of its exposure, and is not published without.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

from jezero.base.camera_preview import PREVIEW_PERIOD_NS, preview_of
from jezero.base.picture_link import ArrivedPicture, decode_picture
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.health import ServiceState
from jezero.schemas.sensors import CameraAttitude, CameraFrame
from jezero.schemas.units import NS_PER_S
from jezero.services.camera.config import CameraDriverConfig

LINK = "camera"
INFO_PERIOD_NS = NS_PER_S
SILENT_NS = 2 * NS_PER_S
"""No picture for this time is worth a word."""
FROZEN_NS = 2 * NS_PER_S
"""The same picture for this time comes from a camera that hangs: a real one has noise. It is not published any more, as
a tag in it would seem to follow the vehicle."""
BLACK_MAX = 16
"""Brightest value of a picture that counts as black."""
BLACK_STEP = 97
"""Every so many bytes of a picture are looked at for that: a prime, so that all colours and columns have their turn."""
ATTITUDE_AGE_MAX_NS = 150_000_000
"""Longest time between a picture and the nearest measurement of the gimbal's angles."""
ATTITUDES_MAX = 100
RATE_WINDOW_NS = 2 * NS_PER_S
RATE_MIN = 0.5
"""Fraction of the configured rate below which the camera is called slow."""
STEPS_BACK_NS = NS_PER_S
"""A picture may be older than the one before by more than this only when vehicle time has begun anew."""

SPEC = Spec(
    name="camera_driver",
    outputs=(topics.CAMERA, topics.CAMERA_INFO, topics.CAMERA_PREVIEW),
    links=(LINK,),
    picture_links=(LINK,),
    triggers=(LINK,),
    rate_hz=5.0,
)


class CameraDriver:
    """Publishes the pictures of a camera with the vehicle time of their exposure.

    Args:
        config: where the pictures come from, and their delay.
        vehicle: size and rate of the pictures, and the camera's mounting.
        source: the camera, for people.
    """

    def __init__(self, config: CameraDriverConfig, vehicle: VehicleConfig, source: str) -> None:
        self._on_gimbal = vehicle.camera.gimbal == "mavlink"
        self.spec = replace(SPEC, inputs=(topics.CAMERA_ATTITUDE,)) if self._on_gimbal else SPEC
        self._attitudes: deque[CameraAttitude] = deque(maxlen=ATTITUDES_MAX)
        self._without_angles = False
        """Whether no angles of the gimbal are known for the newest picture."""
        self._config = config
        self._mount = vehicle.camera
        self._source = source
        self._sequence = 0
        self._t_ns = 0
        """Vehicle time of the last published picture."""
        self._arrivals: deque[int] = deque()
        """Times of arrival of the pictures of the last `RATE_WINDOW_NS`."""
        self._newest: ArrivedPicture | None = None
        self._same_since_ns = 0
        """Time of arrival of the first of the pictures that are all like the newest one."""
        self._black = False
        self._missing = ""
        """Why there is no picture, as the link says."""
        self._broken = 0
        self._silent_since_ns: int | None = None
        """Wall time since which no picture has come."""
        self._next_info_ns = 0
        self._preview_period = -1
        """Number of the period, from time 0, whose preview is published."""
        self._health: tuple[ServiceState, str] = ("starting", "")
        self._next_health_ns = 0

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publish the picture that has arrived, and say what is wrong with the camera."""
        host_ns = inbox.wall_ns + inbox.stalled_ns
        if self._silent_since_ns is None:
            self._silent_since_ns = host_ns
        if self._on_gimbal:
            self._attitudes.extend(inbox.new(topics.CAMERA_ATTITUDE))
        if data := inbox.received(LINK):
            received = decode_picture(data)
            self._broken = received.broken
            if isinstance(received, ArrivedPicture):
                yield from self._on_picture(received, t_ns, host_ns)
            else:
                self._missing = received.reason
        if t_ns >= self._next_info_ns or self._next_info_ns > t_ns + INFO_PERIOD_NS:
            self._next_info_ns = t_ns + INFO_PERIOD_NS
            yield Publish(topics.CAMERA_INFO, self._mount.info(t_ns))
        yield from self._report(t_ns, host_ns)

    def _on_picture(self, picture: ArrivedPicture, t_ns: int, host_ns: int) -> Iterable[Output]:
        last, self._newest = self._newest, picture
        self._missing, self._silent_since_ns = "", host_ns
        self._arrivals.append(picture.arrival_ns)
        while picture.arrival_ns - self._arrivals[0] > RATE_WINDOW_NS:
            self._arrivals.popleft()
        if last is None or last.pixels != picture.pixels:  # compares until the first difference only
            self._same_since_ns = picture.arrival_ns
            self._black = max(picture.pixels[::BLACK_STEP], default=0) <= BLACK_MAX
        exposed_ns = t_ns - (host_ns - picture.arrival_ns) - int(self._config.exposure_delay_s * NS_PER_S)
        is_newer = exposed_ns > self._t_ns or exposed_ns < self._t_ns - STEPS_BACK_NS
        if t_ns <= 0 or exposed_ns < 0 or not is_newer or self._size_problem or self._is_frozen:
            return
        angles_rad = self._angles_rad(exposed_ns)
        self._without_angles = angles_rad is None
        if angles_rad is None:
            return
        self._t_ns = exposed_ns
        self._sequence += 1
        frame = CameraFrame(
            t_ns=exposed_ns,
            sequence=self._sequence,
            width_px=picture.width_px,
            height_px=picture.height_px,
            pitch_camera_rad=angles_rad[0],
            roll_camera_rad=angles_rad[1],
            exposure_s=self._config.exposure_s,
            pixels=picture.pixels,
        )
        yield Publish(topics.CAMERA, frame)
        period = exposed_ns // PREVIEW_PERIOD_NS
        if period != self._preview_period:
            self._preview_period = period
            yield Publish(topics.CAMERA_PREVIEW, preview_of(frame))

    def _angles_rad(self, t_ns: int) -> tuple[float, float] | None:
        """Pitch and roll of the camera at a time; None while the gimbal's are unknown."""
        if not self._on_gimbal:
            return self._mount.pitch_rest_rad, self._mount.roll_offset_rad
        nearest = min(self._attitudes, key=lambda each: abs(each.t_ns - t_ns), default=None)
        if nearest is None or abs(nearest.t_ns - t_ns) > ATTITUDE_AGE_MAX_NS:
            return None
        return nearest.pitch_camera_rad, nearest.roll_camera_rad

    # -- health -----------------------------------------------------------------------------------------------

    @property
    def _size_problem(self) -> str:
        """What is wrong with the size of the pictures, or ""."""
        picture, mount = self._newest, self._mount
        if picture is None or (picture.width_px, picture.height_px) == (mount.width_px, mount.height_px):
            return ""
        return (
            f"the pictures have {picture.width_px} x {picture.height_px} pixels, but the camera of vehicle.toml has "
            f"{mount.width_px} x {mount.height_px}: set the camera to that size, or width_px and height_px to the "
            "camera's and calibrate it again (jezero camera calibrate)"
        )

    @property
    def _is_frozen(self) -> bool:
        return self._newest is not None and self._newest.arrival_ns - self._same_since_ns >= FROZEN_NS

    def _report(self, t_ns: int, host_ns: int) -> Iterable[Output]:
        """Publish a new state at once, and a new sentence once a second."""
        health = self._state(t_ns, host_ns)
        if health != self._health and (health[0] != self._health[0] or host_ns >= self._next_health_ns):
            self._health, self._next_health_ns = health, host_ns + NS_PER_S
            yield Health(*health)

    def _state(self, t_ns: int, host_ns: int) -> tuple[ServiceState, str]:
        silent_ns = host_ns - (self._silent_since_ns or host_ns)
        damaged = f"; {self._broken} damaged pictures were left out" if self._broken else ""
        if self._missing or silent_ns >= SILENT_NS:
            why = self._missing or "nothing comes from it"
            state: ServiceState = "starting" if self._newest is None and silent_ns < SILENT_NS else "degraded"
            return state, f"no picture from {self._source} for {silent_ns / NS_PER_S:.0f} s: {why}{damaged}"
        if self._newest is None:
            return "starting", f"waiting for the first picture from {self._source}"
        span_ns = self._arrivals[-1] - self._arrivals[0]
        rate_hz = (len(self._arrivals) - 1) * NS_PER_S / span_ns if span_ns > 0 else 0.0
        text = f"{rate_hz:.0f} pictures a second from {self._source}{damaged}"
        if problem := next(self._problems(self._newest, t_ns), ""):
            return "degraded", problem
        if span_ns > RATE_WINDOW_NS // 2 and rate_hz < RATE_MIN * self._mount.rate_hz:
            return "degraded", f"only {text}, where rate_hz in vehicle.toml is {self._mount.rate_hz:g}"
        return "ok", text

    def _problems(self, newest: ArrivedPicture, t_ns: int) -> Iterator[str]:
        """What is wrong with the pictures that come, the worst first."""
        if problem := self._size_problem:
            yield problem
        if t_ns <= 0:
            yield "pictures come, but there is no vehicle time yet: does the vehicle bridge run?"
        if self._without_angles:
            yield "pictures come, but not the gimbal's angles: `jezero ps` says at vehicle_bridge what is wrong with it"
        if self._black:
            yield f"the pictures from {self._source} are black: is the lens covered, or the exposure too short?"
        if self._is_frozen:
            same_s = (newest.arrival_ns - self._same_since_ns) / NS_PER_S
            yield f"{self._source} has sent the same picture for {same_s:.0f} s: if it hangs, switch it off and on"
