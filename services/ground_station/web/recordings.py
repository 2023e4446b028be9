"""Looking back: the list of recordings, and each recording with the views and the controls of its flight.

A recording takes the place of a live vehicle on its page: `PlaybackFeed` has what the page reads of a `Feed`.
"""

import asyncio
import os
import secrets
import time
from collections.abc import Callable
from datetime import datetime
from html import escape
from math import ceil
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from nicegui import events, ui
from nicegui.element import Element

from jezero.base.files import describe_os_error
from jezero.recording.folder import recordings_in
from jezero.recording.mcap_file import RecordingError
from jezero.recording.writer import RECORDING
from jezero.services.ground_station.playback import Playback, RecordedFlight
from jezero.services.ground_station.state import ShownState
from jezero.services.ground_station.web.elements import STATIC, Backpressure, set_changed

FLIGHTS_KEPT = 2
"""Recordings whose index is kept; another one is read anew."""
OPEN_MAX = 8
"""Pages that show recordings at the same time: each has a place of its own in a file."""
READING_WAIT_S = 0.5
"""A recording that is read for longer than this gets a page that shows the progress of the reading."""
RECORDED = "this is a recording: nothing can be flown"
NO_STATUS = "The recording has no status of this time."
SPEED_MAX = 50.0
ADVANCE_PERIOD_S = 0.1
MARKS_MAX = 150
"""More marks would touch each other."""
TONES = ("plain", "good", "warning", "bad")
"""Tones of marks, the least important first. Of marks that overlap, the most important one is shown."""


# -- files --


class OpenedRecording:
    """A recording that is read, or was read.

    Attributes:
        flight: its content, for `problem` "" and `fraction` 1.
        fraction: fraction of the file that was read.
        problem: why it can't be shown, or "".
    """

    def __init__(self, path: Path, version: tuple[int, int]) -> None:
        self.flight = RecordedFlight(path)
        self.version = version
        self.fraction = 0.0
        self.problem = ""
        self._task = asyncio.create_task(asyncio.to_thread(self._read))

    def _read(self) -> None:
        try:
            self.flight.index(self._on_progress)
        except (RecordingError, OSError) as error:
            self.problem = describe_os_error(error) if isinstance(error, OSError) else str(error)
        else:
            self.problem = "" if self.flight.keyframes else f"{self.flight.path} has no messages"
        self.fraction = 1.0

    def _on_progress(self, fraction: float) -> None:
        self.fraction = min(fraction, 0.99)


class Recordings:
    """The recordings of a run's folder, or a single one.

    Args:
        place: a recording, or the folder of a run; None for none.
    """

    def __init__(self, place: Path | None) -> None:
        self._place = place
        self._readings: dict[Path, OpenedRecording] = {}

    def _paths(self) -> list[Path]:
        if self._place is None or not self._place.exists():
            return []
        if not self._place.is_dir():
            return [self._place]
        flight = self._place / RECORDING
        return [*recordings_in(self._place), *([flight] if flight.exists() else [])]

    @property
    def is_one(self) -> bool:
        """Whether a single recording is shown, and no folder."""
        return self._place is not None and not self._place.is_dir()

    def newest_first(self) -> list[tuple[str, os.stat_result]]:
        """Name and state of each recording's file, by the time of their last change."""
        found = [(path.name, path.stat()) for path in self._paths()]
        return sorted(found, key=lambda each: each[1].st_mtime, reverse=True)

    def open(self, name: str) -> OpenedRecording | None:
        """Begin to read a recording, or return the reading that has begun; None when there is no such recording."""
        path = next((path for path in self._paths() if path.name == name), None)
        if path is None:
            return None
        stat = path.stat()
        version = (stat.st_size, stat.st_mtime_ns)
        reading = self._readings.get(path)
        if reading is None or (reading.fraction == 1.0 and reading.version != version):
            self._readings.pop(path, None)
            while len(self._readings) >= FLIGHTS_KEPT:
                del self._readings[next(iter(self._readings))]
            reading = self._readings[path] = OpenedRecording(path, version)
        return reading


# -- one recording on a page --


class PlaybackFeed:
    """Plays a recording.

    Attributes:
        flight: the recording.
        playing: whether time goes on.
        speed: seconds of the flight per second.
        problem: why there is no state, where there is none.
        uav: there is none to fly.
        vehicle: name of the vehicle to fly: "", as there is none.
        ground: the shape of the ground, which no recording has: it is drawn level.
        ground_version: number of that shape.
    """

    uav = None
    vehicle = ""
    ground = None
    ground_version = 0

    def __init__(self, flight: RecordedFlight, playback: Playback) -> None:
        self.flight = flight
        self.playing, self.speed, self.problem = False, 1.0, NO_STATUS
        self._playback = playback
        self._wanted_s: float | None = None
        self._updated_s = time.monotonic()

    @property
    def state(self) -> ShownState:
        """State of the vehicle at the present time of the recording."""
        return self._playback.state

    @property
    def now_s(self) -> float:
        """Present time of the recording."""
        return self._playback.t_s

    def play(self, playing: bool) -> None:
        """Start or pause; at the end, start again from the beginning."""
        if playing and self.now_s >= self.flight.duration_s:
            self._wanted_s = 0.0
        self.playing = playing

    def seek(self, t_s: float) -> None:
        """Go to a time at the next `advance`."""
        self._wanted_s = t_s

    def set_speed(self, speed: float) -> None:
        """Set the seconds of the flight per second."""
        self.speed = min(max(speed, 0.1), SPEED_MAX)

    async def advance(self) -> None:
        """Move on by the time since the last call, or to the time that `seek` was given."""
        now_s, before_s = time.monotonic(), self._updated_s
        self._updated_s = now_s
        wanted_s, self._wanted_s = self._wanted_s, None
        if wanted_s is None:
            if not self.playing:
                return
            wanted_s = self.now_s + self.speed * min(now_s - before_s, 1.0)
        try:
            await asyncio.to_thread(self._playback.move_to, wanted_s)
        except RecordingError as error:
            self.problem, self.playing = str(error), False
        if self.now_s >= self.flight.duration_s:
            self.playing = False


class Timeline(Element, component="static/timeline.js"):
    """Emits `play`, `seek` and `speed`."""

    def __init__(self, duration_s: float, marks: list[dict[str, Any]]) -> None:
        super().__init__()
        self.props["duration"] = duration_s
        self.props["marks"] = marks


class PlaybackBar:
    """Controls of the recording on one page."""

    def __init__(self, feed: PlaybackFeed) -> None:
        self._backpressure = Backpressure(ui.context.client)
        self._feed = feed
        flight = feed.flight
        ui.add_css(STATIC / "timeline.css")
        with ui.element("footer").classes("playback"):
            self._line = Timeline(flight.duration_s, _marks_of(flight))
            if flight.problem:
                ui.label(flight.problem).classes("playback-problem")
        self._line.on("play", lambda event: feed.play(bool(event.args)))
        self._line.on("seek", self._seek)
        self._line.on("speed", self._set_speed)
        ui.timer(ADVANCE_PERIOD_S, self._advance)

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
        set_changed(self._line, "now", shown)


def _marks_of(flight: RecordedFlight) -> list[dict[str, Any]]:
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


# -- pages --


class RecordingPages:
    """The pages of the recordings.

    Args:
        recordings: the recordings that are shown.
        show: builds the page of one, from its feed, the address of its pictures and the request.
    """

    def __init__(self, recordings: Recordings, show: Callable[[PlaybackFeed, str, Request], None]) -> None:
        self._recordings = recordings
        self._show = show
        self._open: dict[str, Playback] = {}

    def add_routes(self, site: FastAPI) -> None:
        """Add the pages."""
        site.add_api_route("/recordings", self._list)
        site.add_api_route("/recorded.jpg", self._send_picture)

        @ui.page("/recording/{name}", title="Recording · jezero", dark=True)
        async def recording(request: Request, name: str) -> Response | None:
            return await self._build(request, name)

    async def _list(self) -> Response:
        listed = self._recordings.newest_first()
        if self._recordings.is_one and listed:
            return RedirectResponse(f"/recording/{quote(listed[0][0])}")
        rows = "".join(
            f'<li><a href="/recording/{quote(name)}">{escape(name)}</a> '
            f"<span>{stat.st_size / 1e6:.1f} MB, {datetime.fromtimestamp(stat.st_mtime):%Y-%m-%d %H:%M:%S}</span></li>"
            for name, stat in listed
        )
        return _plain(
            "Recordings", f"<ul>{rows}</ul>" if rows else "<p>There is no recording in this run's folder.</p>"
        )

    async def _build(self, request: Request, name: str) -> Response | None:
        reading = self._recordings.open(name)
        if reading is None:
            return _plain("No such recording", f"<p>There is no recording {escape(name)}.</p>", 404)
        for _ in range(10):
            if reading.fraction < 1.0:
                await asyncio.sleep(READING_WAIT_S / 10)
        if reading.fraction < 1.0:
            return _plain(
                "Reading …", f"<p>{100.0 * reading.fraction:.0f} % of {escape(name)} is read.</p>", again=True
            )
        if reading.problem:
            return _plain("Not readable", f"<p>{escape(reading.problem)}</p>", 422)
        if len(self._open) >= OPEN_MAX:
            return _plain("Too many recordings are open", "<p>Close another page that shows one.</p>", 429)
        try:
            playback = await asyncio.to_thread(Playback, reading.flight)
        except RecordingError as error:
            return _plain("Not readable", f"<p>{escape(str(error))}</p>", 422)
        token = secrets.token_urlsafe(16)
        self._open[token] = playback
        ui.context.client.on_delete(lambda: self._open.pop(token, None))
        self._show(PlaybackFeed(reading.flight, playback), f"/recorded.jpg?page={token}", request)
        return None

    async def _send_picture(self, page: str) -> Response:
        playback = self._open.get(page)
        picture = None if playback is None or playback.picture is None else playback.picture.decoded()
        if picture is None:
            return Response(status_code=204)
        return Response(picture[1], media_type=f"image/{picture[0]}", headers={"Cache-Control": "no-store"})


def _plain(title: str, body: str, status: int = 200, *, again: bool = False) -> Response:
    page = (STATIC / "plain.html").read_text(encoding="utf-8")
    refresh = '<meta http-equiv="refresh" content="1">' if again else ""
    for mark, text in (("refresh", refresh), ("title", escape(title)), ("body", body)):
        page = page.replace(f"{{{{{mark}}}}}", text)
    return HTMLResponse(page, status, headers={"Cache-Control": "no-store"})
