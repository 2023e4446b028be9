"""Settings of the ventral camera; the defaults are those of `deploy/config/camera.toml`."""

from math import radians, tan
from typing import Annotated, Literal

from msgspec import Meta

from jezero.runtime.config import Config
from jezero.schemas.sensors import CameraInfo

NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
Small = Annotated[float, Meta(ge=-10.0, le=10.0)]


class ProjectionConfig(Config, frozen=True, kw_only=True):
    """Errors of the corners that a detector finds, measured on rendered pictures by `benchmarks.quality.camera_errors`.

    A tag's size is the root of its area in pixels; blur is how far its middle moves during the exposure. What is
    called `_per_blur2` is added once for each square pixel of blur.

    Attributes:
        size_half_px: at which half of the tags are found, standing still.
        size_width_px: how many pixels larger or smaller takes the odds to e : 1.
        size_per_blur: pixels by which each pixel of blur raises `size_half_px`.
        share_in_shadow: of the tags that are found where the vehicle's shadow falls.
        radius_shadow_m: of that shadow.
        std_corner_px: of each corner coordinate by itself.
        std_shift_px: of an error that all corners of a tag share.
        std_size_px: of an error of the tag's size.
        shrinks_per_blur2: pixels by which the tag seems smaller.
    """

    size_half_px: Positive = 18.0
    size_width_px: Positive = 1.5
    size_per_blur: NonNegative = 0.8
    share_in_shadow: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.63
    radius_shadow_m: NonNegative = 0.33
    std_corner_px: NonNegative = 0.08
    std_corner_per_blur2: NonNegative = 0.012
    std_shift_px: NonNegative = 0.0
    std_shift_per_blur2: NonNegative = 0.0
    std_size_px: NonNegative = 0.075
    std_size_per_blur2: NonNegative = 0.0
    shrinks_per_blur2: NonNegative = 0.034


class CameraConfig(Config, frozen=True, kw_only=True):
    """The ventral camera.

    Attributes:
        mode: "rendered" publishes pictures; "projected" publishes what a detector would find in them, a hundred times
            cheaper.
        renderer: "auto" takes EGL where there is one, else PyBullet's TinyRenderer.
        rate_hz: at most the simulator's 15 exposures per second; "tiny" manages about 5.
        field_of_view_deg: across the picture's width.
        pos_camera_frd_m: of the optical centre, from the centre of mass.
        pitch_rest_rad: where it looks while nobody commands its axes.
        axis_rate_max_rps: how fast they turn.
        hold_pitch_s: after this time without a command they return to rest.
        delay_s: from the middle of the exposure until the picture is published.
        std_pixel: noise of each colour of each pixel, of 255.
    """

    mode: Literal["rendered", "projected"] = "rendered"
    renderer: Literal["auto", "egl", "tiny"] = "auto"
    rate_hz: Annotated[float, Meta(gt=0.0, le=60.0)] = 15.0
    width_px: Annotated[int, Meta(ge=16, le=4096)] = 640
    height_px: Annotated[int, Meta(ge=16, le=4096)] = 480
    field_of_view_deg: Annotated[float, Meta(gt=1.0, le=150.0)] = 80.0
    pos_camera_frd_m: tuple[Small, Small, Small] = (0.0, 0.0, 0.03)
    pitch_rest_rad: Annotated[float, Meta(ge=-1.5708, le=0.0)] = -1.5708
    axis_rate_max_rps: Positive = 1.5
    hold_pitch_s: Positive = 1.0
    exposure_s: NonNegative = 0.004
    delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.1
    std_pixel: NonNegative = 4.0
    projection: ProjectionConfig = ProjectionConfig()

    @property
    def focal_px(self) -> float:
        return 0.5 * self.width_px / tan(0.5 * radians(self.field_of_view_deg))

    @property
    def center_px(self) -> tuple[float, float]:
        return (0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1))

    def info(self, t_ns: int) -> CameraInfo:
        """Its own description."""
        return CameraInfo(
            t_ns=t_ns,
            width_px=self.width_px,
            height_px=self.height_px,
            focal_px=self.focal_px,
            center_px=self.center_px,
            pos_camera_frd_m=self.pos_camera_frd_m,
            rate_hz=self.rate_hz,
        )
