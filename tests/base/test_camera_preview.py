"""The preview of a camera's frame: small enough for a radio, and the same picture."""

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from jezero.base.camera_preview import SIDE_MAX_PX, preview_of
from jezero.base.codec import BadPayloadError, decode, encode, join_attachment, split_attachment
from jezero.schemas.sensors import PREVIEW_MAX_BYTES, CameraFrame, CameraPreview

RED, GREEN, BLUE, WHITE = (200, 30, 30), (30, 160, 30), (30, 30, 200), (230, 230, 230)


def frame_of(pixels: Any) -> CameraFrame:
    height_px, width_px, _ = pixels.shape
    return CameraFrame(
        t_ns=7,
        sequence=1,
        width_px=width_px,
        height_px=height_px,
        pitch_camera_rad=-1.5,
        roll_camera_rad=0.1,
        exposure_s=0.004,
        pixels=pixels.astype(np.uint8).tobytes(),
    )


def quarters(width_px: int = 640, height_px: int = 480) -> CameraFrame:
    """Red and green above, blue and white below."""
    pixels = np.zeros((height_px, width_px, 3))
    down, right = height_px // 2, width_px // 2
    pixels[:down, :right], pixels[:down, right:] = RED, GREEN
    pixels[down:, :right], pixels[down:, right:] = BLUE, WHITE
    return frame_of(pixels)


def read(preview: CameraPreview) -> Any:
    with Image.open(io.BytesIO(preview.jpeg)) as image:
        return np.asarray(image.convert("RGB")).astype(int)


@pytest.mark.parametrize("size", [(640, 480), (480, 640), (1920, 1080), (2000, 3), (1, 1)])
def test_pure_noise_fits_into_the_limit_too(size: tuple[int, int]) -> None:
    width_px, height_px = size
    noise = frame_of(np.random.default_rng(0).integers(0, 256, (height_px, width_px, 3)))
    preview = preview_of(noise)
    assert 0 < len(preview.jpeg) <= PREVIEW_MAX_BYTES
    assert read(preview).shape == (preview.height_px, preview.width_px, 3)
    assert preview.width_px == pytest.approx(preview.scale * width_px, abs=1.0)
    assert preview.height_px == pytest.approx(preview.scale * height_px, abs=1.0)


def test_a_calm_picture_keeps_its_full_size_and_a_noisy_one_becomes_smaller() -> None:
    calm = preview_of(quarters())
    noisy = preview_of(frame_of(np.random.default_rng(0).integers(0, 256, (480, 640, 3))))
    assert (calm.width_px, calm.height_px, calm.scale) == (SIDE_MAX_PX, 360, 0.75)
    assert noisy.width_px < calm.width_px


def test_colours_and_directions_are_those_of_the_frame() -> None:
    found = read(preview_of(quarters()))
    height_px, width_px, _ = found.shape
    for (row, column), colour in {(1, 1): RED, (1, 3): GREEN, (3, 1): BLUE, (3, 3): WHITE}.items():
        assert found[row * height_px // 4, column * width_px // 4] == pytest.approx(np.array(colour), abs=8)


def test_a_frame_that_is_small_already_keeps_its_pixels() -> None:
    preview = preview_of(quarters(64, 48))
    assert (preview.width_px, preview.height_px, preview.scale) == (64, 48, 1.0)


def test_a_preview_keeps_time_and_angles_of_its_frame() -> None:
    frame = quarters()
    preview = preview_of(frame)
    assert (preview.t_ns, preview.pitch_camera_rad, preview.roll_camera_rad) == (7, -1.5, 0.1)


def test_a_preview_travels_as_a_header_in_json_and_its_bare_jpeg() -> None:
    preview = preview_of(quarters())
    header, jpeg = split_attachment(encode(preview))
    assert jpeg == preview.jpeg and b"jpeg" not in header
    assert decode(CameraPreview, encode(preview)) == preview


@pytest.mark.parametrize(
    ("jpeg", "why"), [(b"", "no JPEG"), (b"GIF89a", "no JPEG"), (b"\xff\xd8\xff" + bytes(18_000), "larger than 18000")]
)
def test_a_preview_that_is_no_jpeg_or_too_large_for_a_radio_is_refused(jpeg: bytes, why: str) -> None:
    header, _ = split_attachment(encode(preview_of(quarters(8, 8))))
    with pytest.raises(BadPayloadError, match=why):
        decode(CameraPreview, join_attachment(header, jpeg))
