"""The output of a service over Zenoh and its links: the `Transport` of its node."""

from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from jezero.codec import has_attachment, split_attachment
from jezero.runtime.config import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.service import Spec
from jezero.runtime.task_runner import TaskRunner
from jezero.runtime.zenoh_session import BusSession
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.topics import key
from jezero.schemas.units import NS_PER_S


class ZenohTransport:
    """Executes the outputs of one service's steps.

    Attributes:
        period_ns: time from a step to the next, unless something triggers one before.
        subscribed: the topics on demand that the service wants; the loop declares them to the router.
    """

    def __init__(
        self, instance: Instance, spec: Spec, session: BusSession, links: Mapping[str, SocketLink], tasks: TaskRunner
    ) -> None:
        self.period_ns = int(NS_PER_S / spec.rate_hz)
        self.subscribed: frozenset[str] = frozenset()
        self._vehicle = instance.vehicle
        self._session = session
        self._links = links
        self._tasks = tasks
        self._last_value = frozenset(topic.name for topic in spec.last_value)
        attached = (endpoint.name for endpoint in spec.serves if has_attachment(endpoint.reply_type))
        self._attached = frozenset(key(instance.vehicle, name) for name in attached)
        """Keys whose replies have attachments."""
        self._queries: dict[int, tuple[str, zenoh.Query]] = {}
        """Queries without a final reply yet, with the keys of their replies."""
        self._request_id = 0

    def keep_query(self, name: str, query: zenoh.Query) -> int:
        """Keep a query to an endpoint until its final reply; returns the request's id."""
        self._request_id += 1
        own = str(query.key_expr) if "*" in name else key(self._vehicle, name)
        self._queries[self._request_id] = (own, query)
        return self._request_id

    def forget_queries(self) -> None:
        """End all requests without a reply."""
        self._queries.clear()

    # -- Transport --

    def publish(self, topic: Topic[Any], data: bytes) -> None:
        if topic.name in self._last_value:
            self._session.set_last_value(topic, data)
        self._session.put(topic, data)

    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None:
        if request_id not in self._queries:
            return
        own, query = self._queries[request_id]
        if data is not None and own in self._attached:
            json, attachment = split_attachment(data)
            octets = zenoh.Encoding.APPLICATION_OCTET_STREAM
            query.reply(own, attachment, encoding=octets, attachment=json)
        elif data is not None:
            query.reply(own, data, encoding=zenoh.Encoding.APPLICATION_JSON)
        if final:
            del self._queries[request_id]
            query.drop()  # type: ignore[no-untyped-call]

    def call(self, endpoint: Endpoint[Any, Any], data: bytes, call_id: str, timeout_s: float) -> None:
        self._session.call(endpoint, data, call_id, timeout_s)

    def send(self, link: str, data: bytes) -> None:
        self._links[link].send(data)

    def subscribe(self, names: frozenset[str]) -> None:
        self.subscribed = names

    def set_rate(self, rate_hz: float) -> None:
        self.period_ns = int(NS_PER_S / rate_hz)

    def run_task(self, function: Callable[[], Any], tag: str) -> None:
        self._tasks.add(function, tag)

    def cancel_task(self, tag: str) -> None:
        self._tasks.cancel(tag)
