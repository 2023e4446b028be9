"""The twin's camera: the stream that it serves is the one that the driver reads."""

import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from jezero.deploy.twin.camera import Pictures, jpeg_of, serve
from jezero.runtime.video import MjpegSource
from jezero.schemas.sensors import CameraFrame

RED = np.broadcast_to(np.array((200, 30, 10), np.uint8), (48, 64, 3))


def frame() -> CameraFrame:
    return CameraFrame(
        t_ns=1,
        sequence=1,
        width_px=64,
        height_px=48,
        pitch_camera_rad=-1.5708,
        exposure_s=0.004,
        pixels=RED.tobytes(),
    )


@pytest.fixture
def pictures() -> Iterator[tuple[Pictures, str]]:
    """Pictures, and the address at which they are served."""
    made = Pictures()
    listener = socket.create_server(("127.0.0.1", 0))
    server = serve(listener, made)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    yield made, f"http://127.0.0.1:{listener.getsockname()[1]}/stream"
    server.shutdown()
    server.server_close()
    thread.join()


def test_the_driver_reads_what_the_twin_serves_in_the_right_colours(pictures: tuple[Pictures, str]) -> None:
    made, url = pictures
    made.put(jpeg_of(frame()))
    source = MjpegSource(url)
    source.wait()
    pixels = source.picture()
    source.close()
    assert pixels is not None
    assert np.abs(pixels.astype(int)[..., ::-1] - RED).max() < 12  # blue, green, red, as OpenCV has them


def test_every_client_gets_each_newer_picture_and_none_twice(pictures: tuple[Pictures, str]) -> None:
    made, url = pictures
    made.put(jpeg_of(frame()))
    sources = [MjpegSource(url), MjpegSource(url)]
    for source in sources:
        source.wait()
    begin_s = time.monotonic()
    threading.Timer(0.3, made.put, [jpeg_of(frame())]).start()
    for source in sources:
        source.wait()
        assert source.picture() is not None
        source.close()
    assert time.monotonic() - begin_s > 0.25
