"""How often the messages of each topic arrive, and the numbers in them over the last minute, for plots.

Times are seconds of a clock that the caller reads.
"""

import json
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Any

from jezero.base.codec import has_attachment
from jezero.recording.channels import json_schema
from jezero.schemas.rows import CLIENTS, GOAL_IN_CHARGE, Topic
from jezero.schemas.topics import TOPICS
from jezero.services.ground_station.words import duration

RATE_SPAN_S = 5.0
ARRIVALS_MAX = 512
LATE_FRACTION = 0.5
"""A topic with less than this fraction of its rate is marked."""
LINKS = tuple(topic for topic in TOPICS if not has_attachment(topic.type))
"""The topics of the table. The camera's images and previews are too large to be read for a count."""
PLOT_SPAN_S = 60.0
PLOT_PERIOD_MIN_S = 0.05
"""Values that follow each other faster are left out: a screen has no more columns."""
SERIES_VALUES_MAX = int(PLOT_SPAN_S / PLOT_PERIOD_MIN_S)
ITEMS_MAX = 9
"""Longer lists, such as covariances of six numbers by six, are not offered."""
AXES = {"ned": ("north", "east", "down"), "frd": ("forward", "right", "down"), "q": ("w", "x", "y", "z")}
UNITS = {
    "m": "m", "mps": "m/s", "mps2": "m/s²", "rad": "rad", "rps": "rad/s", "s": "s", "ns": "ns", "deg": "°", "px": "px",
    "hz": "Hz", "v": "V", "a": "A", "pa": "Pa", "ut": "µT", "kelvin": "K", "celsius": "°C",
}  # fmt: skip
NOT_PLOTTED = frozenset({"t_ns", "pixels"})


# -- rates --


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
        counted_s = min(now_s - self._start_s, RATE_SPAN_S)
        rows = []
        for topic in LINKS:
            arrivals = self._arrivals.get(topic.name, ())
            seen_hz = sum(t_s > now_s - RATE_SPAN_S for t_s in arrivals) / max(counted_s, 1.0)
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


# -- plots --


@dataclass(frozen=True)
class PlotField:
    """A number in the messages of a topic.

    Attributes:
        topic: name of the topic.
        path: names of fields and places in lists that lead to it.
        label: its name for people, which is unique within the topic.
        unit: its unit by its name, "" without one.
    """

    topic: str
    path: tuple[str | int, ...]
    label: str
    unit: str

    def value_in(self, message: Any) -> float | None:
        """Its value in a message; None when it is absent or not finite."""
        value = message
        for step in self.path:
            if value is None:
                return None
            if isinstance(step, int):
                value = value[step] if step < len(value) else None
            else:
                value = getattr(value, step, None)
        if not isinstance(value, int | float) or not isfinite(value):
            return None
        return float(value)


def plottable_topics() -> list[str]:
    """Names of the topics whose numbers can be plotted."""
    return [topic.name for topic in TOPICS if not has_attachment(topic.type) and fields_of(topic)]


def fields_of(topic: Topic[Any]) -> list[PlotField]:
    """The numbers in the messages of a topic, by its schema."""
    return list(_walk(topic.name, json.loads(json_schema(topic.name)), ()))


def _walk(topic: str, node: dict[str, Any], path: tuple[str | int, ...]) -> Iterator[PlotField]:
    match node.get("type"):
        case "object":
            for name, inner in node.get("properties", {}).items():
                if name not in NOT_PLOTTED:
                    yield from _walk(topic, inner, (*path, name))
        case "array" if node.get("items", {}).get("type") in ("number", "integer"):
            for place in range(_length(node)):
                yield _field(topic, (*path, place))
        case "number" | "integer" | "boolean":
            yield _field(topic, path)


def _length(node: dict[str, Any]) -> int:
    length = node.get("maxItems", 0)
    return length if length == node.get("minItems") and length <= ITEMS_MAX else 0


def _field(topic: str, path: tuple[str | int, ...]) -> PlotField:
    names = [str(step) for step in path]
    words = names[-1 if isinstance(path[-1], str) else -2].split("_")
    unit = UNITS.get(words[-1], "") if len(words) > 1 else ""
    if isinstance(path[-1], int):
        axes = next((AXES[word] for word in words if word in AXES), ())
        names[-1] = axes[path[-1]] if path[-1] < len(axes) else names[-1]
    return PlotField(topic, path, ".".join(names), unit)


class PlotSeries:
    """The values of one field during the last minute. It is bounded, whatever the rate."""

    def __init__(self, field: PlotField) -> None:
        self.field = field
        self._values: deque[tuple[float, float]] = deque(maxlen=SERIES_VALUES_MAX)

    def on_message(self, now_s: float, message: Any) -> None:
        """Take a message of the field's topic."""
        if self._values and now_s - self._values[-1][0] < PLOT_PERIOD_MIN_S:
            return
        value = self.field.value_in(message)
        if value is not None:
            self._values.append((now_s, value))

    def since(self, t_s: float) -> list[tuple[float, float]]:
        """Times and values after a time, the oldest first."""
        newer = []
        for entry in reversed(self._values):
            if entry[0] <= t_s:
                break
            newer.append(entry)
        return newer[::-1]
