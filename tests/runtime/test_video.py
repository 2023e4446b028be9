"""The link to a real camera: each kind of source, and each way in which it fails and comes back."""

import http.server
import io
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jezero.base.config import ConfigError
from jezero.base.picture_link import ArrivedPicture, NoPicture, decode_picture
from jezero.runtime import video
from jezero.runtime.video import CaptureSource, MjpegSource, OpenSource, SourceError, VideoLink, shown_source, source_of

pytestmark = pytest.mark.process

RATE_HZ = 20.0
DEADLINE_S = 30.0


def numbered(number: int, width_px: int = 64, height_px: int = 48) -> Any:
    """A picture, blue, green, red: green alone, brighter with each number."""
    picture = np.zeros((height_px, width_px, 3), np.uint8)
    picture[..., 1] = 40 + number % 200
    return picture


def jpeg_of(number: int, width_px: int = 64, height_px: int = 48) -> bytes:
    return cv2.imencode(".jpg", numbered(number, width_px, height_px))[1].tobytes()


@contextmanager
def reading(open_source: OpenSource) -> Iterator[VideoLink]:
    link = VideoLink(open_source, RATE_HZ)
    link.start()
    try:
        yield link
    finally:
        link.close()


def next_from(link: VideoLink, wanted: Callable[[ArrivedPicture | NoPicture], bool]) -> Any:
    """The next delivery that is as wanted."""
    deadline_s = time.monotonic() + DEADLINE_S
    seen: list[Any] = []
    while time.monotonic() < deadline_s:
        select.select(link.sockets(), [], [], 0.1)
        if data := link.poll(time.monotonic_ns()):
            seen.append(decode_picture(data))
            if wanted(seen[-1]):
                return seen[-1]
    raise AssertionError(f"not within {DEADLINE_S:g} s; the last deliveries: {[type(s).__name__ for s in seen[-5:]]}")


def is_picture(delivery: ArrivedPicture | NoPicture) -> bool:
    return isinstance(delivery, ArrivedPicture)


def says(words: str) -> Callable[[ArrivedPicture | NoPicture], bool]:
    return lambda delivery: isinstance(delivery, NoPicture) and words in delivery.reason


# -- MJPEG over HTTP ------------------------------------------------------------------------------------------


class MjpegServer:
    """A camera that misbehaves on request.

    Attributes:
        part: makes the next part of the stream from its number; None is silence.
        content_type: of the reply.
        status: of the reply.
        announces_length: whether each part has its length.
    """

    def __init__(self, port: int = 0) -> None:
        self.part: Callable[[int], bytes | None] = jpeg_of
        self.content_type = "multipart/x-mixed-replace; boundary=frame"
        self.status = 200
        self.announced: Callable[[bytes], int | None] = len
        self._ended = threading.Event()
        camera = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def log_message(self, *words: object) -> None:
                """Print nothing."""

            def do_GET(self) -> None:
                self.send_response(camera.status)
                self.send_header("Content-Type", camera.content_type)
                self.end_headers()
                number = 0
                try:
                    while camera.status == 200 and not camera._ended.wait(0.02):
                        number += 1
                        if (part := camera.part(number)) is None:
                            continue
                        length = camera.announced(part)
                        head = b"" if length is None else b"Content-Length: %d\r\n" % length
                        self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\n" + head + b"\r\n" + part + b"\r\n")
                except OSError:
                    pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.port: int = self._server.server_port
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    @property
    def open_source(self) -> OpenSource:
        return source_of("source", f"http://127.0.0.1:{self.port}/stream", (64, 48), RATE_HZ)

    def kill(self) -> None:
        self._ended.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@pytest.fixture
def server() -> Iterator[MjpegServer]:
    server = MjpegServer()
    yield server
    server.kill()


def test_a_stream_brings_pictures_in_red_green_blue_with_the_time_of_their_arrival(server: MjpegServer) -> None:
    before_ns = time.monotonic_ns()
    with reading(server.open_source) as link:
        picture = next_from(link, is_picture)
        assert (picture.width_px, picture.height_px, link.up, link.connections) == (64, 48, True, 1)
        pixels = np.frombuffer(picture.pixels, np.uint8).reshape(48, 64, 3)
        assert pixels[..., 1].mean() > 35 and pixels[..., (0, 2)].mean() < 8
        assert before_ns < picture.arrival_ns <= time.monotonic_ns()


def test_only_the_newest_picture_counts(server: MjpegServer) -> None:
    with reading(server.open_source) as link:
        first = next_from(link, is_picture)
        arrived = threading.Event()
        arrived.wait(0.5)
        later = next_from(link, is_picture)
        assert later.arrival_ns - first.arrival_ns > 300_000_000
        assert time.monotonic_ns() - later.arrival_ns < 400_000_000


def test_no_more_pictures_come_than_configured(server: MjpegServer) -> None:
    with reading(server.open_source) as link:
        arrivals = [next_from(link, is_picture).arrival_ns for _ in range(20)]
    assert (arrivals[-1] - arrivals[0]) / 19 > 0.8e9 / RATE_HZ


def test_a_stream_without_lengths_is_read_too(server: MjpegServer) -> None:
    server.announced = lambda part: None
    with reading(server.open_source) as link:
        assert next_from(link, is_picture).width_px == 64
        assert next_from(link, is_picture).broken == 0


def test_half_pictures_are_left_out_and_counted_and_whole_ones_are_read_again(server: MjpegServer) -> None:
    with reading(server.open_source) as link:
        next_from(link, is_picture)
        server.part = lambda number: jpeg_of(number)[: 300 if number % 2 else None]
        assert next_from(link, lambda d: d.broken >= 3)
        server.announced = lambda part: 600  # more than there is
        server.part = jpeg_of
        next_from(link, lambda d: d.broken >= 6)
        server.announced = len
        next_from(link, is_picture)


def test_garbage_is_named_and_pictures_are_read_when_they_come_again(server: MjpegServer) -> None:
    server.part = lambda number: b"\x00\xffnot a picture" * 100
    with reading(server.open_source) as link:
        next_from(link, says("are damaged"))
        assert not link.up
        server.part = jpeg_of
        next_from(link, is_picture)


PIECES = st.one_of(
    st.binary(max_size=40),
    st.sampled_from(
        [
            b"--frame\r\n",
            b"--",
            b"\r\n",
            b"\r\n\r\n",
            b"Content-Length: 5\r\n",
            b"Content-Length: 99999999999\r\n",
            b"content-length:-1\r\n",
            b"Content-Type: image/jpeg\r\n",
            b"\xff\xd8\xff",
            b"\xff\xd9",
            jpeg_of(1),
            jpeg_of(2)[:100],
        ]
    ),
)


class Bytes(io.BytesIO):
    """The reply of a camera that sends these bytes, and ends."""

    headers: ClassVar = {"Content-Type": "multipart/x-mixed-replace; boundary=frame"}


@pytest.mark.long
@settings(max_examples=10_000, database=None)
@given(pieces=st.lists(PIECES, max_size=12))
def test_no_bytes_of_a_stream_raise_anything_but_the_reason_and_a_good_picture_is_read_after_them(
    pieces: list[bytes],
) -> None:
    good = b"--frame\r\nContent-Length: %d\r\n\r\n" % len(jpeg_of(7)) + jpeg_of(7) + b"\r\n"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(video, "_open_url", lambda url: Bytes(b"".join(pieces) + b"\r\n" + 3 * good))
        source = MjpegSource("http://127.0.0.1/stream")
    pictures = []
    with pytest.raises(SourceError):
        while True:
            source.wait()
            pictures.append(source.picture())
    announced = b"".join(pieces).lower().count(b"content-length: 99999999999")
    assert announced or any(picture is not None and abs(int(picture[0, 0, 1]) - 47) < 4 for picture in pictures)


def test_silence_is_named_and_ends(server: MjpegServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "SILENCE_MAX_S", 0.5)
    with reading(server.open_source) as link:
        next_from(link, is_picture)
        server.part = lambda number: None
        next_from(link, says("it has sent nothing for"))
        server.part = jpeg_of
        next_from(link, is_picture)


def test_another_size_passes_as_it_is(server: MjpegServer) -> None:
    with reading(server.open_source) as link:
        next_from(link, is_picture)
        server.part = lambda number: jpeg_of(number, 128, 96)
        assert next_from(link, lambda d: isinstance(d, ArrivedPicture) and d.width_px == 128).height_px == 96


def test_a_server_that_is_killed_is_named_and_found_again() -> None:
    first = MjpegServer()
    with reading(first.open_source) as link:
        next_from(link, is_picture)
        first.kill()
        next_from(link, lambda d: says("the stream")(d) or says("nobody answers")(d))
        next_from(link, says("nobody answers there"))
        second = MjpegServer(first.port)
        try:
            next_from(link, is_picture)
            assert link.connections == 2
        finally:
            second.kill()


@pytest.mark.parametrize(
    ("status", "content_type", "words"),
    [
        (404, "text/html", "the camera refuses the address: 404"),
        (200, "text/html", "it sends text/html, where a stream is multipart"),
        (200, "image/jpeg", "it sends image/jpeg"),
    ],
)
def test_what_is_no_stream_is_named(server: MjpegServer, status: int, content_type: str, words: str) -> None:
    server.status, server.content_type = status, content_type
    with reading(server.open_source) as link:
        next_from(link, says(words))


# -- files ----------------------------------------------------------------------------------------------------


def test_the_pictures_of_a_folder_come_in_order_and_begin_anew_without_a_gap(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), numbered(50 * number))
    (tmp_path / "notes.txt").write_text("no picture")
    with reading(source_of("source", f"file:{tmp_path}", (64, 48), 3.0)) as link:
        pictures = [next_from(link, is_picture) for _ in range(5)]
        assert [picture.pixels[1] for picture in pictures] == [40, 90, 140, 40, 90]
        assert pictures[3].arrival_ns - pictures[2].arrival_ns < 0.9e9


def test_a_damaged_picture_of_a_folder_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "0.png").write_bytes(b"nonsense")
    (tmp_path / "1.png").write_bytes(b"")
    cv2.imwrite(str(tmp_path / "2.png"), numbered(1))
    with reading(source_of("source", f"file:{tmp_path}", (64, 48), RATE_HZ)) as link:
        assert next_from(link, is_picture).broken == 2


def test_a_video_is_played_at_its_own_rate_and_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for number in range(5):
        writer.write(numbered(number))
    writer.release()
    with reading(source_of("source", f"file:{path}", (64, 48), RATE_HZ)) as link:
        arrivals = [next_from(link, is_picture).arrival_ns for _ in range(5)]
        assert (arrivals[-1] - arrivals[0]) / 4 > 0.08e9
        next_from(link, says("the video has ended"))
        next_from(link, is_picture)


def test_what_is_no_video_is_named(tmp_path: Path) -> None:
    (tmp_path / "notes.mp4").write_text("no video")
    (tmp_path / "empty").mkdir()
    for name, words in (
        ("notes.mp4", "it is no video"),
        ("empty", "no picture in the folder"),
        ("lost", "no such file"),
    ):
        with reading(source_of("source", f"file:{tmp_path / name}", (64, 48), RATE_HZ)) as link:
            next_from(link, says(words))


# -- devices --------------------------------------------------------------------------------------------------


class FakeDevice:
    """What `cv2.VideoCapture` gives for a device: pictures, until it is unplugged."""

    def __init__(self, pictures: list[Any]) -> None:
        self._pictures = pictures
        self.released = False

    def grab(self) -> bool:
        time.sleep(0.01)
        return bool(self._pictures)

    def retrieve(self) -> tuple[bool, Any]:
        picture = self._pictures.pop(0)
        return picture is not None, picture

    def release(self) -> None:
        self.released = True


def test_a_device_that_is_unplugged_is_named_released_and_opened_again() -> None:
    devices = [FakeDevice([numbered(1), None, numbered(2)[..., :1].copy()]), FakeDevice([numbered(3)])]
    waiting = list(devices)

    def open_device() -> CaptureSource:
        if not waiting:
            raise SourceError("there is no such device")
        return CaptureSource(waiting.pop(0), "was it unplugged?")

    with reading(open_device) as link:
        next_from(link, is_picture)
        next_from(link, says("was it unplugged?"))
        assert devices[0].released
        next_from(link, lambda d: isinstance(d, ArrivedPicture) and d.pixels[1] == 43)
        next_from(link, says("there is no such device"))
        assert link.connections == 2


def test_a_library_that_raises_ends_no_thread() -> None:
    calls: list[int] = []

    def open_device() -> CaptureSource:
        calls.append(1)
        if len(calls) == 1:
            raise cv2.error("no")
        return CaptureSource(FakeDevice([numbered(1)]), "end")

    with reading(open_device) as link:
        next_from(link, says("it can't be read: error: no"))
        next_from(link, is_picture)


def test_a_device_that_is_not_there_is_named() -> None:
    with reading(source_of("source", "/dev/video-none", (64, 48), RATE_HZ)) as link:
        next_from(link, says("there is no such device: is it plugged in?"))


def test_an_rtsp_camera_that_is_off_is_named() -> None:
    with reading(source_of("source", "rtsp://127.0.0.1:9/stream", (64, 48), RATE_HZ)) as link:
        next_from(link, says("no stream can be opened there"))


# -- addresses ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "address", ["camera", "video0", "ftp://host/x", "rtsp://", "http://:80/x", "file:", "http://h:x/"]
)
def test_what_is_no_address_is_refused_with_those_there_are(address: str) -> None:
    with pytest.raises(ConfigError, match=r"write /dev/video0, rtsp://HOST/PATH, http://HOST:PORT/PATH"):
        source_of("source in camera_driver.toml", address, (64, 48), RATE_HZ)


def test_a_camera_on_the_network_needs_a_persons_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="no TLS"):
        source_of("source", "rtsp://192.168.1.20/stream", (64, 48), RATE_HZ)
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    source_of("source", "rtsp://192.168.1.20/stream", (64, 48), RATE_HZ)


def test_a_password_is_not_shown() -> None:
    assert shown_source("rtsp://me:secret@10.0.0.2:554/a@b") == "rtsp://10.0.0.2:554/a@b"
    with pytest.raises(ConfigError) as error:
        source_of("source", "ftp://me:secret@host/x", (64, 48), RATE_HZ)
    assert "secret" not in str(error.value)
