"""Pictures for people: PNG files, and what is said when there is no camera."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from jezero.base.codec import encode
from jezero.cli.flight import camera
from jezero.cli.survey import map_
from jezero.cli.terminal import UNREACHABLE
from jezero.client import JezeroError
from jezero.client.png import png_of
from jezero.client.session import decode
from jezero.schemas.sensors import CameraFrame

FRAME = CameraFrame(
    t_ns=5, sequence=1, width_px=2, height_px=1, pitch_camera_rad=-1.5, exposure_s=0.01, pixels=b"\n\x00\xffabc"
)


def test_a_png_holds_exactly_the_pixels() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    read = cv2.imdecode(np.frombuffer(png_of(5, 7, pixels.tobytes()), dtype=np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    assert (read[..., ::-1] == pixels).all()


def test_the_client_reads_what_the_bus_carries() -> None:
    assert decode(CameraFrame, encode(FRAME)) == FRAME


@pytest.mark.parametrize("data", [b"", b"{}\n", encode(FRAME)[:-1]])
def test_what_is_no_picture_is_an_error_with_a_name(data: bytes) -> None:
    with pytest.raises(JezeroError):
        decode(CameraFrame, data)


def test_without_a_router_the_command_says_so_and_writes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "picture.png"
    result = CliRunner().invoke(camera, ["snap", str(file), "--router", "tcp/127.0.0.1:1"])
    assert result.exit_code == UNREACHABLE
    assert "unreachable" in result.output
    assert not file.exists()


def test_an_orthophoto_with_too_many_pixels_is_refused(tmp_path: Path) -> None:
    arguments = ["orthophoto", str(tmp_path / "a.png"), "--side", "200", "--resolution", "0.002"]
    result = CliRunner().invoke(camera, arguments)
    assert result.exit_code == 2
    assert "20,000 pixels" in result.output


@pytest.mark.parametrize("words", [(camera, "snap"), (camera, "orthophoto"), (map_, "folder", "--out")])
def test_a_picture_under_a_name_of_another_kind_is_refused(words: Any, tmp_path: Path) -> None:
    command, *arguments = words
    result = CliRunner().invoke(command, [*arguments, str(tmp_path / "a.jpg")])
    assert result.exit_code == 2
    assert "a.jpg is no name of a PNG file: end it with .png" in result.output
