"""A TCP relay that can hold everything back for a while, as a network that drops out does."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Self

from jezero.deploy.launcher.ports import HOST


class Relay:
    """Passes the bytes of any number of connections on to a port of this host, inside its `with` block.

    While it is parted nothing passes and nothing is lost: what was sent waits, in both directions.
    """

    def __init__(self, port: int) -> None:
        self._target = (HOST, port)
        self._listener = socket.create_server((HOST, 0))
        self._joined = threading.Event()
        self._joined.set()
        self._open: list[socket.socket] = []
        self._threads: list[threading.Thread] = []

    @property
    def port(self) -> int:
        return int(self._listener.getsockname()[1])

    def __enter__(self) -> Self:
        self._start(self._accept)
        return self

    def __exit__(self, *_: object) -> None:
        self._joined.set()
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
    def parted(self) -> Iterator[None]:
        """Nothing passes in the `with` block."""
        self._joined.clear()
        try:
            yield
        finally:
            self._joined.set()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # ended
            while True:
                near, _ = self._listener.accept()
                self._open.append(near)
                self._joined.wait()
                try:
                    far = socket.create_connection(self._target)
                except OSError:  # no router there
                    _end(near)
                    continue
                self._open.append(far)
                self._start(self._pump, near, far)
                self._start(self._pump, far, near)

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        """One direction, until either end closes."""
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self._joined.wait()
                sink.sendall(data)
        self._joined.wait()
        _end(source)
        _end(sink)


def _end(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
