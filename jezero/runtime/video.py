"""The link to a real camera: a thread that reads its pictures, of which only the newest counts.

A camera's library blocks until a picture is there, or until a time-out when there is none. The thread waits in it and
notes when each picture has arrived; the loop of the service fetches the newest one.
"""

import os
import re
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Protocol
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from jezero.base.config import ConfigError
from jezero.base.picture_link import ArrivedPicture, NoPicture, encode_picture
from jezero.runtime.instance import checked_host
from jezero.runtime.links import HasFileno

Pixels = npt.NDArray[np.uint8]
"""(height, width, 3), blue, green, red, as OpenCV has them."""
RETRY_S = 1.0
SILENCE_MAX_S = 2.0
"""A stream that sends nothing for this time is opened again."""
OPEN_TIMEOUT_S = 5.0
BROKEN_MAX = 50
"""A stream is opened again when so many pictures in a row can't be read."""
EARLY = 0.2
"""Part of a period by which a picture may come early and is still taken."""
STREAM_OPTIONS = "rtsp_transport;tcp|fflags;nobuffer|flags;low_delay|analyzeduration;200000|probesize;50000"
"""FFmpeg's options that keep its buffers small. With its own defaults an RTSP stream is read up to 1.5 s late."""
PICTURES = (".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff")
JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
JPEG_MAX_BYTES = 32_000_000
LINE_MAX_BYTES = 65_536
SOURCES = (
    "/dev/video0, rtsp://HOST/PATH, http://HOST:PORT/PATH (MJPEG), or file:PATH of a video or a folder of pictures"
)


class SourceError(Exception):
    """A camera gives no pictures; the message says why."""


class Source(Protocol):
    """An open camera. Its functions block."""

    def wait(self) -> None:
        """Wait until the next picture has arrived.

        Raises:
            SourceError: there are no more.
        """

    def picture(self) -> Pixels | None:
        """The picture that has arrived, or None where it is damaged."""

    def close(self) -> None: ...


OpenSource = Callable[[], Source]
"""Opens a camera; raises `SourceError` where it can't."""


class VideoLink:
    """A link that brings the newest picture of a camera, which is opened again once a second when it is lost.

    Args:
        open_source: opens the camera; called in the link's thread.
        rate_hz: pictures per second; the others are dropped before they are decoded.
    """

    def __init__(self, open_source: OpenSource, rate_hz: float) -> None:
        self._open_source = open_source
        self._period_ns = int(1e9 / rate_hz)
        self.up = False
        self.connections = 0
        self._newest: ArrivedPicture | NoPicture | None = None
        self._broken = 0
        self._arrived_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._ended = threading.Event()
        self._lock = threading.Lock()
        """Guards the descriptor, which `close` closes."""

    def start(self) -> None:
        threading.Thread(target=self._run, name="camera", daemon=True).start()

    def sockets(self) -> Sequence[HasFileno]:
        return [] if self._ended.is_set() else [_Descriptor(self._arrived_fd)]

    def poll(self, wall_ns: int) -> bytes:
        """The newest picture that has not been read yet, or why there is none; see `jezero.base.picture_link`."""
        with self._lock:
            if not self._ended.is_set():
                with suppress(BlockingIOError):
                    os.eventfd_read(self._arrived_fd)
            newest, self._newest = self._newest, None
        return b"" if newest is None else encode_picture(newest)

    def send(self, data: bytes) -> None:
        """A camera takes no bytes."""

    def close(self) -> None:
        """End the thread, which may still wait in the camera's library and ends with the process at the latest."""
        self._ended.set()
        with self._lock:
            os.close(self._arrived_fd)

    # -- the thread --

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                self._read_until_lost()
            except SourceError as error:
                reason = str(error)
            except Exception as error:  # noqa: BLE001 - the libraries raise what they like, and it is tried again
                reason = f"it can't be read: {type(error).__name__}: {error}"
            else:
                return
            self.up = False
            self._put(NoPicture(reason[:500], self._broken))
            self._ended.wait(RETRY_S)

    def _read_until_lost(self) -> None:
        """Read pictures until the link is closed.

        Raises:
            SourceError: the camera gives no more.
        """
        source = self._open_source()
        try:
            due_ns = broken_in_row = 0
            while not self._ended.is_set():
                source.wait()
                arrival_ns = time.monotonic_ns()
                if arrival_ns < due_ns - EARLY * self._period_ns:
                    continue
                due_ns = max(due_ns + self._period_ns, arrival_ns)
                pixels = source.picture()
                if pixels is None:
                    self._broken += 1
                    broken_in_row += 1
                    if broken_in_row >= BROKEN_MAX:
                        raise SourceError(f"the last {BROKEN_MAX} pictures are damaged: what it sends is no pictures")
                    continue
                broken_in_row = 0
                if not self.up:
                    self.connections += 1
                    self.up = True
                self._put(_picture_of(pixels, arrival_ns, self._broken))
        finally:
            source.close()

    def _put(self, newest: ArrivedPicture | NoPicture) -> None:
        with self._lock:
            self._newest = newest
            if not self._ended.is_set():
                os.eventfd_write(self._arrived_fd, 1)


class _Descriptor:
    """A file descriptor to wait on."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def fileno(self) -> int:
        return self._descriptor


def _picture_of(pixels: Pixels, arrival_ns: int, broken: int) -> ArrivedPicture:
    import cv2

    kind = cv2.COLOR_GRAY2RGB if pixels.ndim == 2 or pixels.shape[2] == 1 else cv2.COLOR_BGR2RGB
    rgb = cv2.cvtColor(pixels, kind)
    return ArrivedPicture(arrival_ns, rgb.shape[1], rgb.shape[0], rgb.tobytes(), broken)


# -- sources ----------------------------------------------------------------------------------------------


def source_of(name: str, address: str, size_px: tuple[int, int], rate_hz: float, pixel_format: str = "") -> OpenSource:
    """What opens the camera that an address names.

    Args:
        name: of the setting, for errors.
        address: one of `SOURCES`.
        size_px: width and height that a device is asked for; other sources have their own.
        rate_hz: pictures per second that a device is asked for, and of a folder.
        pixel_format: four letters of V4L2's name of the format that a device is asked for; "" for its own choice.

    Raises:
        ConfigError: the address is none of these, or leads to another computer without a person's permission.
    """
    if re.fullmatch(r"/dev/.+", address):
        return lambda: _open_device(address, size_px, rate_hz, pixel_format)
    if (file := re.fullmatch(r"file:(.+)", address)) is not None:
        path = Path(file[1])
        return lambda: FolderSource(path, rate_hz) if path.is_dir() else _open_video(path)
    if re.match(r"(rtsp|http)://", address) and (host := _host_of(address)) is not None:
        checked_host(name, host)
        return (lambda: _open_rtsp(address)) if address.startswith("rtsp") else (lambda: MjpegSource(address))
    raise ConfigError(f"{name} is {shown_source(address)!r}: write {SOURCES}")


def _host_of(address: str) -> str | None:
    try:
        parts = urlsplit(address)
        return parts.hostname if parts.port != 0 else None
    except ValueError:
        return None


def shown_source(address: str) -> str:
    """The address for people, without the user's name and password in it."""
    return re.sub(r"//[^/@]*@", "//", address)


class CaptureSource:
    """A camera that OpenCV reads.

    Args:
        capture: an open `cv2.VideoCapture`, or what behaves like one.
        end: why it has no more pictures, for people.
        period_s: time between two pictures of a file, whose pictures are there at once; None for a camera.
    """

    def __init__(self, capture: Any, end: str, period_s: float | None = None) -> None:
        self._capture = capture
        self._end = end
        self._period_s = period_s
        self._due_s = 0.0

    def wait(self) -> None:
        if self._period_s is not None:
            self._due_s = _paced(self._due_s, self._period_s)
        if not self._capture.grab():
            raise SourceError(self._end)

    def picture(self) -> Pixels | None:
        read, pixels = self._capture.retrieve()
        return pixels if read and pixels is not None and pixels.size else None

    def close(self) -> None:
        self._capture.release()


def _paced(due_s: float, period_s: float) -> float:
    """Wait until a time is due; returns when the next one is."""
    now_s = time.monotonic()
    if due_s > now_s:
        time.sleep(due_s - now_s)
    return now_s + period_s if due_s < now_s - period_s else due_s + period_s


def _quiet_cv2() -> Any:
    """OpenCV, whose FFmpeg prints nothing: why a stream is lost stands in health."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    import cv2

    return cv2


def _open_device(path: str, size_px: tuple[int, int], rate_hz: float, pixel_format: str) -> Source:
    if not os.path.exists(path):
        raise SourceError("there is no such device: is it plugged in? `ls /dev/video*` lists those there are")
    if not os.access(path, os.R_OK | os.W_OK):
        raise SourceError("this user may not open it: add the user to the group `video`, and log in again")
    cv2 = _quiet_cv2()
    capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
    if not capture.isOpened():
        capture.release()
        raise SourceError("it can't be opened: another program may have it, or it gives no pictures")
    if pixel_format:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*pixel_format))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
    capture.set(cv2.CAP_PROP_FPS, rate_hz)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return CaptureSource(capture, "it gives no more pictures: was it unplugged?")


def _open_rtsp(url: str) -> Source:
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = STREAM_OPTIONS
    cv2 = _quiet_cv2()
    timeouts = [
        *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1000 * OPEN_TIMEOUT_S)),
        *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(1000 * SILENCE_MAX_S)),
    ]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, timeouts)
    if not capture.isOpened():
        capture.release()
        raise SourceError("no stream can be opened there: is the camera on, and are address and password right?")
    return CaptureSource(capture, f"the stream has ended, or was silent for {SILENCE_MAX_S:g} s")


def _open_video(path: Path) -> Source:
    if not path.exists():
        raise SourceError("there is no such file or folder")
    cv2 = _quiet_cv2()
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        capture.release()
        raise SourceError("it can't be opened: it is no video, or can't be read")
    rate_hz = capture.get(cv2.CAP_PROP_FPS)
    return CaptureSource(capture, "the video has ended: it begins anew", 1.0 / rate_hz if rate_hz >= 1.0 else 0.1)


class FolderSource:
    """The pictures of a folder, in the order of their names, again and again.

    Args:
        path: the folder.
        rate_hz: pictures per second.

    Raises:
        SourceError: there are no pictures in it.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES)
        if not self._files:
            raise SourceError(f"there is no picture in the folder ({', '.join(PICTURES)})")
        self._next = -1
        self._period_s = 1.0 / rate_hz
        self._due_s = 0.0

    def wait(self) -> None:
        self._due_s = _paced(self._due_s, self._period_s)
        self._next = (self._next + 1) % len(self._files)

    def picture(self) -> Pixels | None:
        try:
            return _decoded(self._files[self._next].read_bytes())
        except OSError:
            return None

    def close(self) -> None:
        """Nothing is open."""


class MjpegSource:
    """A camera that sends JPEG after JPEG over HTTP.

    OpenCV's FFmpeg would hand out half a picture as a whole one.

    Args:
        url: of the stream.

    Raises:
        SourceError: nobody is there, or sends no such stream.
    """

    def __init__(self, url: str) -> None:
        try:
            self._response: IO[bytes] = _open_url(url)
        except urllib.error.HTTPError as error:
            error.close()
            raise SourceError(f"the camera refuses the address: {error.code} {error.reason}") from None
        except (OSError, ValueError) as error:  # urllib's errors, time-outs and malformed replies are such
            why = getattr(error, "reason", error)
            raise SourceError(f"nobody answers there ({why}): is the camera on, and the address right?") from None
        kind = str(getattr(self._response, "headers", {}).get("Content-Type", ""))
        if not kind.lower().startswith("multipart/"):
            self._response.close()
            raise SourceError(f"it sends {kind or 'something'}, where a stream is multipart/x-mixed-replace")
        self._jpeg = b""

    def wait(self) -> None:
        try:
            self._jpeg = self._next_part()
        except TimeoutError:
            raise SourceError(f"it has sent nothing for {SILENCE_MAX_S:g} s") from None
        except (OSError, ValueError) as error:
            raise SourceError(f"the stream broke off ({error})") from None

    def picture(self) -> Pixels | None:
        whole = self._jpeg.startswith(JPEG_START) and self._jpeg.endswith(JPEG_END)
        return _decoded(self._jpeg) if whole else None

    def close(self) -> None:
        self._response.close()

    def _next_part(self) -> bytes:
        """The next part of the stream, which should be a JPEG; a part that is too short is found at the next line."""
        skipped = 0
        while not (line := self._line()).startswith(b"--"):
            skipped += len(line)
            if skipped > JPEG_MAX_BYTES:
                raise SourceError("what it sends is no MJPEG stream")
        length = None
        while line := self._line().strip():
            name, _, value = line.partition(b":")
            if name.strip().lower() == b"content-length" and value.strip().isdigit():
                length = int(value)
        if length is None:
            return self._until_end()
        if length > JPEG_MAX_BYTES:
            raise SourceError(f"it announces a picture of {length} bytes")
        data = self._response.read(length)
        if len(data) < length:
            raise SourceError("the stream has ended within a picture")
        return data.rstrip(b"\r\n")

    def _until_end(self) -> bytes:
        """A part without its length, until the end of its JPEG."""
        data = b""
        while not data.endswith((JPEG_END, JPEG_END + b"\r\n", JPEG_END + b"\n")) and len(data) < JPEG_MAX_BYTES:
            data += self._line()
        return data.rstrip(b"\r\n")

    def _line(self) -> bytes:
        line = self._response.readline(LINE_MAX_BYTES)
        if not line:
            raise SourceError("the stream has ended")
        return line


def _open_url(url: str) -> Any:
    """Open a stream, with the user's name and password of its address; whatever a proxy is set."""
    parts = urlsplit(url)
    plain = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
    passwords = urllib.request.HTTPPasswordMgrWithDefaultRealm()
    passwords.add_password(None, plain, parts.username or "", parts.password or "")
    handlers = (urllib.request.HTTPBasicAuthHandler(passwords), urllib.request.HTTPDigestAuthHandler(passwords))
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), *(handlers if parts.username else ()))
    return opener.open(plain, timeout=SILENCE_MAX_S)


def _decoded(data: bytes) -> Pixels | None:
    """A picture from the bytes of its file, or None."""
    if not data:
        return None
    pixels: Pixels | None = _quiet_cv2().imdecode(np.frombuffer(data, np.uint8), 1)  # 1: in colour
    return pixels
