"""The twin's camera: its rendered pictures over HTTP, as a network camera sends them.

It is a process of its own, as compressing pictures would hold up the lines: `python -m jezero.deploy.twin.camera`.
"""

import http.server
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from jezero.client import Vehicle
from jezero.client.errors import JezeroError
from jezero.deploy.launcher.ports import HOST, instance_environment
from jezero.runtime.instance import Instance
from jezero.schemas import topics
from jezero.schemas.sensors import CameraFrame

QUALITY = 90
DELAY_S = 0.12
"""Estimated time from the middle of an exposure until its picture has arrived at a client. The simulated camera delays
each picture by 0.1 s; rendering, JPEG and the way take the rest."""
BOUNDARY = "picture"
RETRY_S = 0.5
END_TIMEOUT_S = 5.0


@contextmanager
def serving_camera(instance: Instance) -> Iterator[str]:
    """Serve the pictures of a stack's camera until the context ends; yields the address of the stream.

    Args:
        instance: the hardware's.
    """
    with socket.create_server((HOST, 0)) as listener:
        command = (sys.executable, "-m", __name__, instance.vehicle, instance.router, str(listener.fileno()))
        environment = {**os.environ, **instance_environment(instance)}
        # It ends when its standard input does, however this process ends.
        process = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, pass_fds=[listener.fileno()])
        try:
            yield f"http://{HOST}:{listener.getsockname()[1]}/stream"
        finally:
            process.kill()
            process.wait(END_TIMEOUT_S)
            if process.stdin is not None:
                process.stdin.close()


class Pictures:
    """The newest picture, for any number of clients."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._jpeg, self._number = b"", 0

    def put(self, jpeg: bytes) -> None:
        """Replace the picture."""
        with self._changed:
            self._jpeg, self._number = jpeg, self._number + 1
            self._changed.notify_all()

    def after(self, number: int) -> tuple[int, bytes]:
        """Wait for a newer picture than the one with this number; returns its number and its JPEG."""
        with self._changed:
            self._changed.wait_for(lambda: self._number > number)
            return self._number, self._jpeg


def serve(listener: socket.socket, pictures: Pictures) -> http.server.ThreadingHTTPServer:
    """Make the server of the stream; `serve_forever` runs it.

    Args:
        listener: a socket that listens already.
    """

    class Handler(http.server.BaseHTTPRequestHandler):
        def log_message(self, *words: object) -> None:
            """Print nothing."""

        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
            self.end_headers()
            number = 0
            try:
                while True:
                    number, jpeg = pictures.after(number)
                    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                    self.wfile.write(head.encode() + jpeg + b"\r\n")
            except OSError:  # the client is gone
                return

    server = http.server.ThreadingHTTPServer(listener.getsockname()[:2], Handler, bind_and_activate=False)
    server.socket.close()
    server.socket = listener
    server.daemon_threads = True
    return server


def jpeg_of(frame: CameraFrame) -> bytes:
    """A frame as a JPEG."""
    import cv2
    import numpy as np

    rgb = np.frombuffer(frame.pixels, np.uint8).reshape(frame.height_px, frame.width_px, 3)
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return jpeg.tobytes()


def _read_pictures(vehicle: str, router: str, pictures: Pictures) -> None:
    """Take the camera's frames from the hardware's bus, for ever."""
    pause = threading.Event()
    while True:
        try:
            with Vehicle.connect(vehicle, router=router) as hardware, hardware.subscribe(topics.CAMERA) as stream:
                for frame in stream:
                    pictures.put(jpeg_of(frame))
        except JezeroError:  # it is not up yet, or was started anew
            pause.wait(RETRY_S)


def main() -> None:
    """Serve until standard input ends."""
    vehicle, router, descriptor = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the twin ends this process
    pictures = Pictures()
    server = serve(socket.socket(fileno=int(descriptor)), pictures)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    threading.Thread(target=_read_pictures, args=(vehicle, router, pictures), daemon=True).start()
    sys.stdin.buffer.read()
    os._exit(0)  # Zenoh's threads may wait for a router that is gone


if __name__ == "__main__":
    main()
