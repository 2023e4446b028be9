"""Who writes a topic: the session of the one service that the topic table names.

Without keys everybody who reaches the router can publish on any topic. While the writer of a topic runs, its readers
refuse messages from other sessions. They know the session of the writer by the claim of the service's name, a
liveliness token that ends with the session. While the writer doesn't run, for example because an estimator of one's own
takes its place, everybody may write.
"""

from collections.abc import Mapping
from typing import Any

import zenoh

from jezero.schemas.rows import CLIENTS, GOAL_IN_CHARGE, Topic

ROVER = "rover"
"""Service of the rover's computer, which writes the topics of that host in the place of the simulator."""


def writers_of(topic: Topic[Any]) -> frozenset[str]:
    """Names of the services that write a topic; none where that changes."""
    if topic.writer in (CLIENTS, GOAL_IN_CHARGE):
        return frozenset()
    return frozenset((topic.writer, ROVER)) if topic.host == ROVER else frozenset((topic.writer,))


def source_of(publisher: zenoh.Publisher) -> zenoh.SourceInfo:
    """The part of each message by which readers know the session of its publisher."""
    return zenoh.SourceInfo(publisher.id, 0)


class Writers:
    """The sessions of services, by their claims.

    Args:
        topics: the topics that are read, by their names.
    """

    def __init__(self, topics: Mapping[str, Topic[Any]]) -> None:
        self._writers = {name: writers_of(topic) for name, topic in topics.items()}
        self._sessions: dict[str, frozenset[str]] = {}
        """Zenoh's ids of the sessions that claim a service's name, by that name. Zenoh's threads read the sets, so that
        a claim makes a new set."""

    def on_claim(self, sample: zenoh.Sample) -> None:
        """Add or remove a claim, a liveliness token …/claim/SERVICE/SESSION."""
        _, service, session = str(sample.key_expr).rsplit("/", 2)
        others = self._sessions.get(service, frozenset()) - {session}
        self._sessions[service] = others | {session} if sample.kind == zenoh.SampleKind.PUT else others

    def refusal(self, name: str, sample: zenoh.Sample) -> str:
        """Reason why a message is refused, because its session is not that of the topic's writer; "" for none."""
        writers = self._writers.get(name, frozenset())
        sessions = frozenset[str]().union(*(self._sessions.get(service, frozenset()) for service in writers))
        if not sessions:
            return ""
        source = sample.source_info
        session = "" if source is None else str(source.source_id.zid)
        if session in sessions:
            return ""
        who = f"session {session}" if session else "a program"
        return f"{who} publishes it, and is not its writer, {' or '.join(sorted(writers))}"
