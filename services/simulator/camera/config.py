"""Settings of the simulated camera. Its optics and its mounting are in `vehicle.toml`."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config

NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]


class ProjectionConfig(Config, frozen=True, kw_only=True):
    """Errors of the corners that a detector finds, measured on rendered images by `benchmarks.quality.camera_errors`.

    A tag's size is the square root of its area in pixels; blur is the distance by which its middle moves during the
    exposure, in pixels. A setting `…_per_blur2` is multiplied by the square of the blur.

    Attributes:
        size_half_px: size at which half of the tags are found, without blur.
        size_width_px: increase of the size that raises the odds of a detection by the factor e.
        size_per_blur: increase of `size_half_px` for each pixel of blur.
        share_in_shadow: fraction of the tags in the vehicle's shadow that are found.
        radius_shadow_m: radius of the vehicle's shadow.
        std_corner_px: standard deviation of the independent error of each corner coordinate, without blur.
        std_corner_per_blur2: increase of `std_corner_px` per square pixel of blur.
        std_shift_px: standard deviation of an error that all corners of a tag share, without blur.
        std_shift_per_blur2: increase of `std_shift_px` per square pixel of blur.
        std_size_px: standard deviation of the error of the tag's size, without blur.
        std_size_per_blur2: increase of `std_size_px` per square pixel of blur.
        shrinks_per_blur2: decrease of the tag's size in pixels, per square pixel of blur.
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
    """Simulation of the camera.

    Attributes:
        mode: "rendered" publishes images; "projected" publishes the corners that a detector would find in them, which
            takes a hundredth of the time.
        renderer: "auto" takes EGL where it is available, else PyBullet's TinyRenderer, which makes 5 images a second.
        axis_rate_max_rps: maximum rate at which the camera's axes turn.
        exposure_s: duration of an exposure.
        delay_s: time from the middle of an exposure until its image is published.
        print_scale: size of the printed landing board relative to the size in `vehicle.toml`.
        std_pixel: standard deviation of the noise of each colour of each pixel, where 255 is full brightness.
        projection: errors of the corners in mode "projected".
    """

    mode: Literal["rendered", "projected"] = "rendered"
    renderer: Literal["auto", "egl", "tiny"] = "auto"
    axis_rate_max_rps: Positive = 1.5
    exposure_s: NonNegative = 0.004
    delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.1
    print_scale: Annotated[float, Meta(ge=0.2, le=2.0)] = 1.0
    std_pixel: NonNegative = 4.0
    projection: ProjectionConfig = ProjectionConfig()
