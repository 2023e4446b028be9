"""How often the messages of each topic arrive, beside how often they should.

Times are seconds of a clock that the caller reads.
"""

from collections import deque
from typing import Any

from jezero.codec import has_attachment
from jezero.schemas.rows import CLIENTS, GOAL_IN_CHARGE
from jezero.schemas.topics import TOPICS
from jezero.services.ground_station.words import duration

SPAN_S = 5.0
ARRIVALS_MAX = 512
LATE_FRACTION = 0.5
"""A topic with less than this fraction of its rate is marked."""
LINKS = tuple(topic for topic in TOPICS if not has_attachment(topic.type))
"""The topics of the table. The camera's images and previews are too large to be read for a count."""


class LinkTable:
    """Counts messages.

    Args:
        now_s: time from which on the messages are counted.
    """

    def __init__(self, now_s: float) -> None:
        self._start_s = now_s
        self._arrivals: dict[str, deque[float]] = {}

    def on_message(self, now_s: float, topic: str) -> None:
        """Count a message."""
        self._arrivals.setdefault(topic, deque(maxlen=ARRIVALS_MAX)).append(now_s)

    def rows(self, now_s: float) -> list[dict[str, Any]]:
        """Each topic with its writer, its rates in Hz and the age of its last message, in words."""
        counted_s = min(now_s - self._start_s, SPAN_S)
        rows = []
        for topic in LINKS:
            arrivals = self._arrivals.get(topic.name, ())
            seen_hz = sum(t_s > now_s - SPAN_S for t_s in arrivals) / max(counted_s, 1.0)
            always = topic.rate_hz is not None and topic.writer not in (GOAL_IN_CHARGE, CLIENTS)
            late = always and counted_s >= 2.0 and seen_hz < LATE_FRACTION * (topic.rate_hz or 0.0)
            rows.append(
                {
                    "name": topic.name,
                    "writer": topic.writer,
                    "expected": "on events" if topic.rate_hz is None else f"{topic.rate_hz:g}",
                    "seen": f"{seen_hz:.1f}" if arrivals else "–",
                    "age": _age(now_s - arrivals[-1]) if arrivals else "never",
                    "late": late,
                }
            )
        return rows


def _age(age_s: float) -> str:
    return f"{1000.0 * max(age_s, 0.0):.0f} ms" if age_s < 1.0 else duration(age_s)
