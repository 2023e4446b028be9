"""The panel of all topics: how often each arrives, and plots of chosen fields.

A topic is read while a page asks for it, and once, however many pages ask.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Iterable
from typing import Any

from nicegui import events, ui
from nicegui.element import Element

from jezero.aio import JezeroError
from jezero.schemas.rows import Topic
from jezero.schemas.topics import TOPICS
from jezero.services.ground_station.topic_data import (
    LINKS,
    PLOT_SPAN_S,
    LinkTable,
    PlotField,
    PlotSeries,
    fields_of,
    plottable_topics,
)
from jezero.services.ground_station.web.elements import STATIC, Backpressure, set_changed
from jezero.services.ground_station.web.feed import RETRY_S, Feed

_BY_NAME = {topic.name: topic for topic in TOPICS}
SERIES_MAX = 40
"""Fields that are plotted at the same time, on all pages together."""
LINES_MAX = 6
"""Lines on one page: there are so many colours."""
PERIOD_S = 0.25


class TopicWatch:
    """Reads topics of one vehicle while a page shows them."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._wanted: Counter[str] = Counter()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._series: dict[PlotField, tuple[PlotSeries, int]] = {}
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

    def open_series(self, field: PlotField) -> PlotSeries | None:
        """Collect the values of a field, for one more page; None when there are too many fields."""
        series, users = self._series.get(field, (PlotSeries(field), 0))
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


class LinkRows(Element, component="static/links.js"):
    """The table of topics; it emits `plot` with the name of a topic."""


class Plot(Element, component="static/plot.js"):
    """Lines over the last minute; it emits `remove` with the number of a line."""


class DataPanel:
    """The panel of one page. Nothing is read for it while it is closed, but for its plots."""

    def __init__(self, watch: TopicWatch) -> None:
        self._backpressure = Backpressure(ui.context.client)
        self._watch = watch
        self._lines: dict[int, PlotSeries] = {}
        self._sent_s: dict[int, float] = {}
        self._numbers = 0
        self._open = False
        self._fields: dict[str, PlotField] = {}
        ui.add_css(STATIC / "data.css")
        with (
            ui.element("section").classes("card data-card"),
            ui.expansion("Plots and links", on_value_change=self._on_open).props('dense data-mark="data"'),
        ):
            names = plottable_topics()
            with ui.element("div").classes("plot-choice"):
                self._topic = ui.select(names, label="topic", on_change=self._on_topic).props(
                    'dense options-dense data-mark="plot-topic"'
                )
                self._field = ui.select([], label="field", on_change=self._add).props(
                    'dense options-dense data-mark="plot-field"'
                )
            self._plot = Plot().on("remove", self._on_remove)
            self._rows = LinkRows().on("plot", self._on_row)
        ui.timer(PERIOD_S, self._refresh)
        ui.context.client.on_delete(self._close)

    def _on_open(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if bool(event.value) == self._open:
            return
        self._open = bool(event.value)
        self._watch.open_links() if self._open else self._watch.close_links()

    def _on_row(self, event: events.GenericEventArguments) -> None:
        if event.args in self._topic.options:
            self._topic.set_value(event.args)

    def _on_topic(self) -> None:
        topic = next((topic for topic in TOPICS if topic.name == self._topic.value), None)
        fields = [] if topic is None else fields_of(topic)
        self._fields = {f"{field.label}{f' ({field.unit})' if field.unit else ''}": field for field in fields}
        self._field.set_options(list(self._fields), value=None)

    def _add(self) -> None:
        field = self._fields.get(str(self._field.value))
        if field is None or any(series.field == field for series in self._lines.values()):
            return
        series = self._watch.open_series(field) if len(self._lines) < LINES_MAX else None
        if series is None:
            ui.notify("There are too many lines: remove one first", type="warning")
            return
        self._lines[self._numbers] = series
        self._numbers += 1
        self._show_lines()

    def _on_remove(self, event: events.GenericEventArguments) -> None:
        series = self._lines.pop(event.args, None) if isinstance(event.args, int) else None
        if series is not None:
            self._watch.close_series(series.field)
            self._show_lines()

    def _show_lines(self) -> None:
        self._plot.props["span"] = PLOT_SPAN_S
        self._plot.props["lines"] = [
            {"id": number, "label": f"{series.field.topic} {series.field.label}", "unit": series.field.unit}
            for number, series in self._lines.items()
        ]

    def _refresh(self) -> None:
        if not self._backpressure.may_send():
            return
        if self._open:
            set_changed(self._rows, "rows", self._watch.link_rows())
        now_s = time.monotonic()
        added = {}
        for number, series in self._lines.items():
            values = series.since(self._sent_s.get(number, now_s - PLOT_SPAN_S))
            if values:
                self._sent_s[number] = values[-1][0]
                added[number] = [[round(t_s - now_s, 3), value] for t_s, value in values]
        if self._lines:
            self._plot.run_method("add", added)

    def _close(self) -> None:
        if self._open:
            self._watch.close_links()
        for series in self._lines.values():
            self._watch.close_series(series.field)
        self._lines, self._open = {}, False
