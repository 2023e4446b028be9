"""Who writes a topic: the session of the one service that the topic table names.

Without keys whoever reaches the router can publish on any topic. A message that comes from another session than that of
a topic's writer is not taken while the writer is there. A writer's session is known by its claim of the service's name,
a liveliness token that ends with it. Where the writer doesn't run, because an estimator of one's own takes its place
for example, everybody may write.
"""

from collections import defaultdict
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
    """What a publisher adds to each message, by which readers know its session."""
    return zenoh.SourceInfo(publisher.id, 0)


class Writers:
    """The sessions of services, by their claims.

    Args:
        topics: the topics that are read, by their names.
    """

    def __init__(self, topics: Mapping[str, Topic[Any]]) -> None:
        self._writers = {name: writers_of(topic) for name, topic in topics.items()}
        self._sessions: defaultdict[str, set[str]] = defaultdict(set)
        """Zenoh's ids of the sessions that claim the name of a service, by that."""

    def on_claim(self, sample: zenoh.Sample) -> None:
        """Take note of a claim that begins or ends: a liveliness token …/claim/SERVICE/SESSION."""
        _, service, session = str(sample.key_expr).rsplit("/", 2)
        if sample.kind == zenoh.SampleKind.PUT:
            self._sessions[service].add(session)
        else:
            self._sessions[service].discard(session)

    def refusal(self, name: str, sample: zenoh.Sample) -> str:
        """Why a message is not taken, or "": another session than that of the topic's writer has sent it."""
        writers = self._writers.get(name, frozenset())
        sessions = [session for service in writers for session in self._sessions[service]]
        if not sessions:
            return ""
        source = sample.source_info
        session = "" if source is None else str(source.source_id.zid)
        if session in sessions:
            return ""
        who = f"session {session}" if session else "a program"
        return f"{who} publishes it, and is not its writer, {' or '.join(sorted(writers))}"
