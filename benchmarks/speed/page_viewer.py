"""A viewer of the ground station's page without a browser: which costs the server as much."""

import http.client
import json
import re
import threading
import time
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Self
from urllib.parse import urlencode, urlsplit
from uuid import uuid4

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

ACK_PERIOD_S = 3.0
RECEIVE_TIMEOUT_S = 0.5
CLIENT_ID = re.compile(r"'client_id': '([0-9a-f-]+)'")
MESSAGE_ID = re.compile(r'"_id":(\d+)')
PING, PONG, CONNECT = "2", "3", "40"
"""Packets of engine.io, on which the page's messages travel."""


class PageViewer:
    """One open page; a context manager.

    Attributes:
        messages: number of messages of the page that were read so far.
        bytes: their size.
        pictures: number of the camera's pictures so far.
        closed: whether the server has closed the connection.
        acknowledges: whether it acknowledges what it has read, as pages do; may be changed at any time.

    Args:
        address: of the pages.
        rate_pictures_hz: how often it asks for a picture of the camera; 0 for never.
        reads: whether it reads what the server sends.
    """

    def __init__(self, address: str, *, rate_pictures_hz: float = 0.0, reads: bool = True) -> None:
        self.messages = self.bytes = self.pictures = 0
        self.closed, self.acknowledges = False, True
        self._host = urlsplit(address).netloc
        self._rate_pictures_hz = rate_pictures_hz
        self._client_id = self._load()
        self._open = ExitStack()
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._look, daemon=True)] if rate_pictures_hz else []
        if reads:
            self._threads.append(threading.Thread(target=self._read, daemon=True))

    def __enter__(self) -> Self:
        self._connection = self._open.enter_context(self._connect())
        self._connection.recv()
        self._connection.send(CONNECT)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()
        self._open.close()

    def _load(self) -> str:
        """Load the page; returns the id that the server has given it."""
        connection = http.client.HTTPConnection(self._host, timeout=30)
        connection.request("GET", "/")
        found = CLIENT_ID.search(connection.getresponse().read().decode())
        connection.close()
        if found is None:
            raise RuntimeError(f"{self._host} serves no page of the ground station")
        return found[1]

    def _connect(self) -> ClientConnection:
        query = {
            "EIO": "4", "transport": "websocket", "client_id": self._client_id, "next_message_id": "0",
            "implicit_handshake": "true", "document_id": str(uuid4()), "tab_id": str(uuid4()),
        }  # fmt: skip
        address = f"ws://{self._host}/_nicegui_ws/socket.io/?{urlencode(query)}"
        origin = Origin(f"http://{self._host}")
        return connect(address, origin=origin, max_queue=1, ping_interval=None, proxy=None)

    def _read(self) -> None:
        next_id, acknowledged_s = 0, time.monotonic()
        while not self._ended.is_set():
            try:
                message = str(self._connection.recv(RECEIVE_TIMEOUT_S))
                if message == PING:
                    self._connection.send(PONG)
                    continue
                self.messages += 1
                self.bytes += len(message)
                found = MESSAGE_ID.search(message)
                next_id = int(found[1]) + 1 if found else next_id
                if self.acknowledges and time.monotonic() - acknowledged_s > ACK_PERIOD_S:
                    acknowledged_s = time.monotonic()
                    body = json.dumps(["ack", {"client_id": self._client_id, "next_message_id": next_id}])
                    self._connection.send(f"42{body}")
            except TimeoutError:
                continue
            except ConnectionClosed:
                self.closed = True
                return

    def drain(self, silence_s: float = 1.0) -> int:
        """Read what waits, of a viewer that does not read; returns the number of messages.

        Args:
            silence_s: it ends when nothing came for this time.
        """
        number = 0
        with suppress(TimeoutError, ConnectionClosed):
            while True:
                number += self._connection.recv(silence_s) != PING
        return number

    def _look(self) -> None:
        connection = http.client.HTTPConnection(self._host, timeout=30)
        while not self._ended.wait(1.0 / self._rate_pictures_hz):
            with suppress(OSError, http.client.HTTPException):
                connection.request("GET", "/camera.jpg")
                reply = connection.getresponse()
                self.pictures += bool(reply.read()) and reply.status == 200
        connection.close()
