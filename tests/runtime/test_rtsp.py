"""A real RTSP server: pictures come, a camera that is switched off is named, and found again."""

import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from jezero.base.picture_link import ArrivedPicture
from jezero.runtime.video import source_of
from tests.runtime.test_video import is_picture, next_from, reading, says

pytestmark = pytest.mark.process

SYSTEM_PYTHON = "/usr/bin/python3"
SERVER = Path(__file__).with_name("rtsp_camera.py")
HAS_SERVER = "import gi; gi.require_version('GstRtspServer', '1.0'); from gi.repository import GstRtspServer"


@contextmanager
def camera(port: int) -> Iterator[None]:
    with subprocess.Popen([SYSTEM_PYTHON, str(SERVER), str(port)], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "sends\n"
            yield
        finally:
            process.kill()


@pytest.mark.slow
def test_pictures_come_by_rtsp_and_come_again_after_the_camera_was_switched_off() -> None:
    words = [SYSTEM_PYTHON, "-c", HAS_SERVER]
    if not shutil.which(SYSTEM_PYTHON) or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("there is no RTSP server: apt-get install gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-ugly")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    source = source_of("source", f"rtsp://127.0.0.1:{port}/camera", (320, 240), 20.0)
    with reading(source) as link:
        for _ in range(2):
            with camera(port):
                picture = next_from(link, is_picture)
                assert isinstance(picture, ArrivedPicture)
                assert (picture.width_px, picture.height_px) == (320, 240)
            next_from(link, says("the stream has ended"))
