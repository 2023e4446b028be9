"""Topics that the pages' table of links and their plots ask for: each is read once, however many pages ask."""

import asyncio
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

from jezero.aio import JezeroError
from jezero.schemas.rows import Topic
from jezero.schemas.topics import TOPICS
from jezero.services.ground_station.topic_data import LINKS, LinkTable, PlotField, Series
from jezero.services.ground_station.web.feed import RETRY_S, Feed

SERIES_MAX = 40
"""Fields that are plotted at the same time, on all pages together."""
_BY_NAME = {topic.name: topic for topic in TOPICS}


class TopicWatch:
    """Reads topics of one vehicle while a page shows them."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._wanted: Counter[str] = Counter()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._series: dict[PlotField, tuple[Series, int]] = {}
        self._tables = 0
        self._links: LinkTable | None = None

    # -- links --

    def open_links(self) -> None:
        """Count the messages of all topics, for one more page."""
        self._tables += 1
        if self._links is None:
            self._links = LinkTable(time.monotonic())
        self._want(topic.name for topic in LINKS)

    def close_links(self) -> None:
        """Count them for one page less."""
        self._tables -= 1
        self._links = self._links if self._tables > 0 else None
        self._leave(topic.name for topic in LINKS)

    def link_rows(self) -> list[dict[str, Any]]:
        """The rows of the table; none while nobody has opened it."""
        return [] if self._links is None else self._links.rows(time.monotonic())

    # -- plots --

    def open_series(self, field: PlotField) -> Series | None:
        """Collect the values of a field, for one more page; None when there are too many fields."""
        series, users = self._series.get(field, (Series(field), 0))
        if users == 0 and len(self._series) >= SERIES_MAX:
            return None
        self._series[field] = (series, users + 1)
        self._want([field.topic])
        return series

    def close_series(self, field: PlotField) -> None:
        """Collect them for one page less."""
        series, users = self._series.pop(field)
        if users > 1:
            self._series[field] = (series, users - 1)
        self._leave([field.topic])

    # -- topics --

    def close(self) -> None:
        """End all tasks."""
        for task in self._tasks.values():
            task.cancel()

    def _want(self, names: Iterable[str]) -> None:
        for name in names:
            self._wanted[name] += 1
            if name not in self._tasks:
                self._tasks[name] = asyncio.create_task(self._read(_BY_NAME[name]))

    def _leave(self, names: Iterable[str]) -> None:
        for name in names:
            self._wanted[name] -= 1
            if self._wanted[name] == 0:
                self._tasks.pop(name).cancel()

    async def _read(self, topic: Topic[Any]) -> None:
        while (uav := self._feed.uav) is None:
            await asyncio.sleep(RETRY_S)
        async with uav.subscribe(topic) as stream:
            while True:
                try:
                    message = await stream.next()
                except JezeroError:  # not valid, or the link is lost
                    await asyncio.sleep(RETRY_S)
                    continue
                now_s = time.monotonic()
                if self._links is not None:
                    self._links.on_message(now_s, topic.name)
                for series, _ in list(self._series.values()):
                    if series.field.topic == topic.name:
                        series.on_message(now_s, message)
