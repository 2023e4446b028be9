"""The controls of a recording: play, speed, and a time line with the events."""

from math import ceil
from typing import Any

from nicegui import events, ui
from nicegui.element import Element

from jezero.services.ground_station.playback import RecordedFlight
from jezero.services.ground_station.web.backpressure import Backpressure
from jezero.services.ground_station.web.elements import STATIC
from jezero.services.ground_station.web.playback_feed import PlaybackFeed

PERIOD_S = 0.1
MARKS_MAX = 150
"""More marks would touch each other."""
TONES = ("plain", "good", "warning", "bad")
"""From the least to the most important; where marks overlap, the more important one is kept."""


class Timeline(Element, component="static/timeline.js"):
    """Emits `play`, `seek` and `speed`."""

    def __init__(self, duration_s: float, marks: list[dict[str, Any]]) -> None:
        super().__init__()
        self.props["duration"] = duration_s
        self.props["marks"] = marks


def marks_of(flight: RecordedFlight) -> list[dict[str, Any]]:
    """Marks of a recording's events; events that would have their marks on one place share one, at the last of them."""
    gap_s = flight.duration_s / MARKS_MAX
    marks: list[dict[str, Any]] = []
    begin_s = 0.0
    for event in flight.events:
        if not marks or event.t_s - begin_s > gap_s:
            begin_s = event.t_s
            marks.append({"tone": event.tone, "texts": []})
        mark = marks[-1]
        mark["t"] = ceil(100.0 * event.t_s) / 100.0  # not before the event
        mark["texts"].append(event.text)
        mark["tone"] = max(mark["tone"], event.tone, key=TONES.index)
    return marks


class PlaybackBar:
    """Controls of the recording on one page."""

    def __init__(self, feed: PlaybackFeed) -> None:
        self._backpressure = Backpressure(ui.context.client)
        self._feed = feed
        flight = feed.flight
        ui.add_css(STATIC / "timeline.css")
        with ui.element("footer").classes("playback"):
            self._line = Timeline(flight.duration_s, marks_of(flight))
            if flight.problem:
                ui.label(flight.problem).classes("playback-problem")
        self._line.on("play", lambda event: feed.play(bool(event.args)))
        self._line.on("seek", self._seek)
        self._line.on("speed", self._set_speed)
        ui.timer(PERIOD_S, self._advance)

    def toggle(self) -> None:
        """Play or pause."""
        self._feed.play(not self._feed.playing)

    def _seek(self, event: events.GenericEventArguments) -> None:
        if isinstance(event.args, int | float):
            self._feed.seek(float(event.args))

    def _set_speed(self, event: events.GenericEventArguments) -> None:
        if isinstance(event.args, int | float):
            self._feed.set_speed(float(event.args))

    async def _advance(self) -> None:
        if not self._backpressure.may_send():
            return
        await self._feed.advance()
        shown = {"t": round(self._feed.now_s, 2), "playing": self._feed.playing, "speed": self._feed.speed}
        if self._line.props.get("now") != shown:
            self._line.props["now"] = shown
