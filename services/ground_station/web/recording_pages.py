"""The pages that look back: the list of recordings, and each recording with the views of a flight."""

import asyncio
import secrets
from collections.abc import Callable
from html import escape
from urllib.parse import quote

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from nicegui import ui

from jezero.recording.mcap_file import RecordingError
from jezero.services.ground_station.playback import Playback
from jezero.services.ground_station.web.elements import STATIC
from jezero.services.ground_station.web.playback_feed import PlaybackFeed
from jezero.services.ground_station.web.recordings import Recordings

OPEN_MAX = 8
"""Pages that show recordings at the same time: each has a place of its own in a file."""
WAIT_S = 0.5
"""A recording that is read for longer than this gets a page that shows the progress of the reading."""


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
            return RedirectResponse(f"/recording/{quote(listed[0].name)}")
        rows = "".join(
            f'<li><a href="/recording/{quote(each.name)}">{escape(each.name)}</a> '
            f"<span>{each.size_mb:.1f} MB, {each.changed}</span></li>"
            for each in listed
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
                await asyncio.sleep(WAIT_S / 10)
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
