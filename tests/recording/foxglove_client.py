"""A client of Foxglove's WebSocket: RFC 6455 and the protocol `foxglove.sdk.v1`, as far as the tests need them."""

import base64
import json
import os
import socket
import struct
import time
from types import TracebackType
from typing import Any, Self

TEXT, BINARY, PING, PONG = 1, 2, 9, 10
MESSAGE_DATA = 1


class FoxgloveClient:
    """A client that subscribes to channels by their topics; a context manager.

    Attributes:
        channels: the channels that the server has announced so far, by topic.
        messages: the messages so far, each (log time in ns, decoded), by topic.
    """

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self.channels: dict[str, Any] = {}
        self.messages: dict[str, list[tuple[int, Any]]] = {}
        self._topics: dict[int, str] = {}
        self._buffer = b""
        self._socket = socket.create_connection((host, port), timeout=5.0)
        request = (
            f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        self._socket.sendall(request.encode())
        while b"\r\n\r\n" not in self._buffer:
            self._buffer += self._socket.recv(4096)
        head, _, self._buffer = self._buffer.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 101"), head

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def subscribe(self, topic: str) -> None:
        """Subscribe to an announced channel."""
        number = len(self._topics) + 1
        self._topics[number] = topic
        self._send({"op": "subscribe", "subscriptions": [{"id": number, "channelId": self.channels[topic]["id"]}]})

    def unsubscribe(self, topic: str) -> None:
        """End a subscription."""
        numbers = [number for number, name in self._topics.items() if name == topic]
        self._send({"op": "unsubscribe", "subscriptionIds": numbers})

    def receive(self, timeout_s: float) -> None:
        """Process what the server has sent; returns after the time-out at the latest."""
        deadline_s = time.monotonic() + timeout_s
        while not self._process_frame() and (left_s := deadline_s - time.monotonic()) > 0.0:
            self._socket.settimeout(left_s)
            try:
                received = self._socket.recv(1 << 20)
            except TimeoutError:
                return
            if not received:
                raise ConnectionError("the server has closed the connection")
            self._buffer += received
        while self._process_frame():
            pass

    def _process_frame(self) -> bool:
        if len(self._buffer) < 2:
            return False
        kind, length, start = self._buffer[0] & 15, self._buffer[1], 2
        if length >= 126:
            start = 4 if length == 126 else 10
            if len(self._buffer) < start:
                return False
            (length,) = struct.unpack(">H" if start == 4 else ">Q", self._buffer[2:start])
        if len(self._buffer) < start + length:
            return False
        content, self._buffer = self._buffer[start : start + length], self._buffer[start + length :]
        if kind == TEXT:
            self._on_text(json.loads(content))
        elif kind == BINARY and content[0] == MESSAGE_DATA:
            _, number, logged_ns = struct.unpack("<BIQ", content[:13])
            self.messages.setdefault(self._topics[number], []).append((logged_ns, json.loads(content[13:])))
        elif kind == PING:
            self._send_frame(PONG, content)
        return True

    def _on_text(self, message: Any) -> None:
        if message["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in message["channels"]}

    def _send(self, message: Any) -> None:
        self._send_frame(TEXT, json.dumps(message).encode())

    def _send_frame(self, kind: int, content: bytes) -> None:
        mask = os.urandom(4)
        length = bytes((0x80 | len(content),)) if len(content) < 126 else b"\xfe" + struct.pack(">H", len(content))
        masked = bytes(byte ^ mask[index % 4] for index, byte in enumerate(content))
        self._socket.sendall(bytes((0x80 | kind,)) + length + mask + masked)
