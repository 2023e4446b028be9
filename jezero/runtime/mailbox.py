"""The inbox of a service, as a bus fills it."""

from collections.abc import Sequence
from typing import Any

from jezero.runtime.service import Request, Response, SentMessage
from jezero.schemas.rows import Endpoint, Topic

LINK_BYTES_MAX = 4_000_000
"""Bytes of a link that wait for the next step; later ones are dropped, so that no peer can fill the memory."""


class Mailbox:
    """The `Inbox` of a service, filled by a bus through `Node`."""

    def __init__(self, declared_links: Sequence[str]) -> None:
        self.wall_ns = 0
        self.connected = True
        self.departed: list[str] = []
        self.responses: list[Response] = []
        self.sent: list[SentMessage] = []
        self._new: dict[str, list[Any]] = {}
        self._latest: dict[str, Any] = {}
        self._requests: dict[str, list[Request]] = {}
        self._bytes: dict[str, list[bytes]] = {link: [] for link in declared_links}
        self._sizes = dict.fromkeys(declared_links, 0)
        self._connections = dict.fromkeys(declared_links, 0)
        self._up = dict.fromkeys(declared_links, False)

    def new(self, topic: Topic[Any]) -> Sequence[Any]:
        return self._new.get(topic.name, ())

    def latest(self, topic: Topic[Any]) -> Any | None:
        return self._latest.get(topic.name)

    @property
    def has_requests(self) -> bool:
        return bool(self._requests)

    def requests(self, endpoint: Endpoint[Any, Any]) -> Sequence[Request]:
        return self._requests.get(endpoint.name, ())

    def received(self, link: str) -> bytes:
        parts = self._bytes[link]
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def connections(self, link: str) -> int:
        return self._connections[link]

    def is_up(self, link: str) -> bool:
        return self._up[link]

    def clear(self) -> None:
        """Remove everything that the last step has read; latest values and link states stay."""
        self._new.clear()
        if self.departed:
            self.departed.clear()
        if self.responses:
            self.responses.clear()
        if self._requests:
            self._requests.clear()
        if self.sent:
            self.sent.clear()
        for link, parts in self._bytes.items():
            if parts:
                parts.clear()
                self._sizes[link] = 0

    def add_message(self, name: str, message: Any) -> None:
        self._latest[name] = message
        if name in self._new:
            self._new[name].append(message)
        else:
            self._new[name] = [message]

    def forget(self, name: str) -> None:
        self._new.pop(name, None)
        self._latest.pop(name, None)

    def add_request(self, name: str, request: Request) -> None:
        self._requests.setdefault(name, []).append(request)

    def add_bytes(self, link: str, data: bytes) -> None:
        size = self._sizes[link] + len(data)
        if size <= LINK_BYTES_MAX:
            self._sizes[link] = size
            self._bytes[link].append(data)

    def set_link(self, link: str, up: bool) -> None:
        if up and not self._up[link]:
            self._connections[link] += 1
        if not up:
            self._bytes[link].clear()
            self._sizes[link] = 0
        self._up[link] = up
