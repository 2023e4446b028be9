"""A relay that can interrupt its connections for a while, like a network partition."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

from jezero.deploy.launcher.ports import HOST


class Relay:
    """Passes the bytes of any number of connections on to a server of this host, inside its `with` block.

    During a partition bytes are held back in both directions; none are lost.

    Args:
        target: port or Unix socket of the server.
        own: path of the relay's own Unix socket; None for a free port.

    Attributes:
        change: what becomes of bytes on their way, in both directions.
    """

    def __init__(self, target: int | Path, own: Path | None = None) -> None:
        self.change: Callable[[bytes], bytes] = bytes
        self._target = target
        if own is None:
            self._listener = socket.create_server((HOST, 0))
        else:
            self._listener = socket.socket(socket.AF_UNIX)
            self._listener.bind(str(own))
            self._listener.listen()
        self._passing = threading.Event()
        self._passing.set()
        self._open: list[socket.socket] = []
        self._threads: list[threading.Thread] = []

    @property
    def port(self) -> int:
        return int(self._listener.getsockname()[1])

    def __enter__(self) -> Self:
        self._start(self._accept)
        return self

    def __exit__(self, *_: object) -> None:
        self._passing.set()
        _end(self._listener)
        self._threads[0].join()
        for connection in self._open:
            _end(connection)
        for thread in self._threads:
            thread.join()
        for connection in (self._listener, *self._open):
            connection.close()

    def _start(self, run: Callable[..., None], *sockets: socket.socket) -> None:
        thread = threading.Thread(target=run, args=sockets, daemon=True)
        self._threads.append(thread)
        thread.start()

    @contextlib.contextmanager
    def partition(self) -> Iterator[None]:
        """Hold all bytes back in the `with` block."""
        self._passing.clear()
        try:
            yield
        finally:
            self._passing.set()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # ended
            while True:
                near, _ = self._listener.accept()
                self._open.append(near)
                self._passing.wait()
                try:
                    far = self._connect()
                except OSError:  # no server there
                    _end(near)
                    continue
                self._open.append(far)
                self._start(self._pump, near, far)
                self._start(self._pump, far, near)

    def _connect(self) -> socket.socket:
        if isinstance(self._target, int):
            return socket.create_connection((HOST, self._target))
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(str(self._target))
        return connection

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        """Pass on one direction, until either end closes."""
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self._passing.wait()
                sink.sendall(self.change(data))
        self._passing.wait()
        _end(source)
        _end(sink)


def _end(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
