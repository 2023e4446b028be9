"""The camera's driver: what it publishes of the pictures, and what it says about them."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from msgspec.structs import replace

from jezero.base.picture_link import ArrivedPicture, NoPicture, encode_picture
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Publish
from jezero.schemas.sensors import CameraAttitude, CameraFrame, CameraInfo, CameraPreview
from jezero.schemas.topics import CAMERA_ATTITUDE
from jezero.services.camera.config import CameraDriverConfig
from jezero.services.camera.service import LINK, CameraDriver

VEHICLE = VehicleConfig(camera=CameraMountConfig(width_px=32, height_px=24, rate_hz=10.0, pitch_offset_rad=0.1))
AHEAD_NS = 5_000_000_000
"""Vehicle time minus the computer's monotonic time."""
STALLED_NS = 700_000_000
DELAY_NS = 80_000_000


def noise(seed: int, width_px: int = 32, height_px: int = 24) -> bytes:
    return np.random.default_rng(seed).integers(20, 255, (height_px, width_px, 3), dtype=np.uint8).tobytes()


@dataclass
class Bench:
    """Steps the driver; `host_ns` is the computer's monotonic time, of which the process has lost `STALLED_NS`."""

    vehicle: VehicleConfig = VEHICLE
    host_ns: int = 60_000_000_000
    ahead_ns: int = AHEAD_NS
    published: list[Publish] = field(default_factory=list)
    health: Health | None = None

    def __post_init__(self) -> None:
        config = CameraDriverConfig(source="/dev/video0", exposure_delay_s=DELAY_NS * 1e-9, exposure_s=0.004)
        self.driver = CameraDriver(config, self.vehicle, "/dev/video0")
        self.inbox = Mailbox([LINK])
        self.number = 0

    def step(self, data: bytes = b"", passed_s: float = 0.1) -> None:
        self.host_ns += int(passed_s * 1e9)
        self.inbox.wall_ns, self.inbox.stalled_ns = self.host_ns - STALLED_NS, STALLED_NS
        if data:
            self.inbox.replace_bytes(LINK, data)
        for output in self.driver.step(max(0, self.host_ns + self.ahead_ns), self.inbox):
            if isinstance(output, Health):
                self.health = output
            else:
                assert isinstance(output, Publish)
                self.published.append(output)
        self.inbox.clear()

    def picture(self, pixels: bytes | None = None, size_px: tuple[int, int] = (32, 24), age_ns: int = 0) -> None:
        """A step 0.1 s later, with a picture that has arrived `age_ns` before it."""
        self.number += 1
        pixels = noise(self.number, *size_px) if pixels is None else pixels
        arrival_ns = self.host_ns + 100_000_000 - age_ns
        self.step(encode_picture(ArrivedPicture(arrival_ns, *size_px, pixels)))

    def frames(self) -> list[CameraFrame]:
        return [each.message for each in self.published if isinstance(each.message, CameraFrame)]

    @property
    def words(self) -> str:
        return "" if self.health is None else f"{self.health.state}: {self.health.text}"


def test_a_picture_is_published_with_the_vehicle_time_of_its_exposure_and_the_fixed_angles() -> None:
    bench = Bench()
    bench.picture(age_ns=30_000_000)
    (frame,) = bench.frames()
    assert frame.t_ns == bench.host_ns + AHEAD_NS - 30_000_000 - DELAY_NS
    assert frame.pitch_camera_rad == pytest.approx(-1.5708 + 0.1)
    assert (frame.roll_camera_rad, frame.exposure_s) == (0.0, 0.004)
    assert (frame.width_px, frame.height_px, frame.pixels) == (32, 24, noise(1))


def test_a_picture_of_a_camera_on_a_gimbal_has_the_angles_of_its_exposure_and_is_not_published_without() -> None:
    bench = Bench(replace(VEHICLE, camera=replace(VEHICLE.camera, gimbal="mavlink")))
    bench.picture()
    assert bench.frames() == []
    assert bench.words.startswith("degraded: pictures come, but not the gimbal's angles")
    exposed_ns = bench.host_ns + 100_000_000 + AHEAD_NS - DELAY_NS
    for age_ns, pitch_rad in ((90_000_000, -0.5), (20_000_000, -0.6), (-60_000_000, -0.7)):
        angles = CameraAttitude(t_ns=exposed_ns - age_ns, pitch_camera_rad=pitch_rad, roll_camera_rad=0.1)
        bench.inbox.add_message(CAMERA_ATTITUDE.name, angles)
    bench.picture()
    (frame,) = bench.frames()
    assert (frame.pitch_camera_rad, frame.roll_camera_rad) == (-0.6, 0.1)
    for _ in range(3):
        bench.picture()
    assert len(bench.frames()) == 3  # the angles are too old for the fourth
    assert "not the gimbal's angles" in bench.words


def test_there_is_info_once_a_second_and_a_preview_twice() -> None:
    bench = Bench()
    for _ in range(41):
        bench.picture()
    kinds = [type(each.message) for each in bench.published]
    assert kinds.count(CameraFrame) == 41
    assert kinds.count(CameraInfo) in (4, 5)
    assert kinds.count(CameraPreview) in (8, 9)
    assert [frame.sequence for frame in bench.frames()] == list(range(1, 42))
    assert bench.words == "ok: 10 pictures a second from /dev/video0"


def test_nothing_is_published_before_vehicle_time_is_known_and_health_says_so() -> None:
    bench = Bench(ahead_ns=-100_000_000_000)
    for _ in range(3):
        bench.picture()
    assert bench.frames() == []
    assert bench.words.startswith("degraded: pictures come, but there is no vehicle time yet")


def test_pictures_stay_in_order_while_the_clock_is_corrected_and_begin_anew_with_vehicle_time() -> None:
    bench = Bench()
    bench.picture()
    bench.ahead_ns -= 150_000_000  # the clock was ahead
    bench.picture()
    assert len(bench.frames()) == 1
    bench.ahead_ns -= 50_000_000_000  # the flight controller has started anew
    bench.picture()
    assert len(bench.frames()) == 2


def test_pictures_of_another_size_than_the_calibrations_are_named_and_not_published() -> None:
    bench = Bench()
    bench.picture(size_px=(64, 48))
    assert bench.frames() == []
    assert "64 x 48 pixels, but the camera of vehicle.toml has 32 x 24" in bench.words
    bench.picture()
    assert len(bench.frames()) == 1
    for _ in range(11):
        bench.picture()
    assert bench.words.startswith("ok: ")


def test_a_frozen_picture_is_named_after_two_seconds_and_not_published_any_more() -> None:
    bench = Bench()
    for _ in range(40):
        bench.picture(pixels=noise(7))
    assert len(bench.frames()) == 20
    assert "degraded: /dev/video0 has sent the same picture for" in bench.words
    bench.picture()
    assert len(bench.frames()) == 21
    assert bench.words.startswith("ok: ")


def test_black_pictures_are_named() -> None:
    bench = Bench()
    for seed in range(3):
        dark = np.random.default_rng(seed).integers(0, 9, 32 * 24 * 3, dtype=np.uint8).tobytes()
        bench.picture(pixels=dark)
    assert "black: is the lens covered" in bench.words


def test_silence_is_named_with_its_duration_and_its_reason_until_a_picture_comes() -> None:
    bench = Bench()
    bench.step()
    assert bench.words == "starting: waiting for the first picture from /dev/video0"
    bench.picture()
    for _ in range(40):
        bench.step()
    assert "degraded: no picture from /dev/video0 for 4 s: nothing comes from it" in bench.words
    bench.step(encode_picture(NoPicture("it was unplugged", broken=3)), passed_s=1.1)
    assert bench.words.endswith("for 5 s: it was unplugged; 3 damaged pictures were left out")
    bench.picture()
    assert bench.words.startswith("ok: ")


def test_a_camera_that_cannot_be_opened_is_starting_first_and_then_degraded() -> None:
    bench = Bench()
    bench.step(encode_picture(NoPicture("there is no such device")))
    assert bench.words == "starting: no picture from /dev/video0 for 0 s: there is no such device"
    for _ in range(4):
        bench.step(encode_picture(NoPicture("there is no such device")), passed_s=1.0)
    assert bench.words == "degraded: no picture from /dev/video0 for 4 s: there is no such device"


def test_a_camera_that_is_much_slower_than_configured_is_named() -> None:
    bench = Bench()
    for _ in range(9):
        bench.picture()
        for _ in range(3):
            bench.step()
    assert "degraded: only 2 pictures a second" in bench.words or "only 3 pictures a second" in bench.words
    assert "rate_hz in vehicle.toml is 10" in bench.words
