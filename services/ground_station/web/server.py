"""The web server of the pages."""

import asyncio
import threading
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import RedirectResponse
from nicegui import Client, ui
from nicegui import app as pages

from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health
from jezero.services.ground_station.access import Listening, insecurities, listening_socket
from jezero.services.ground_station.views import robot_shapes
from jezero.services.ground_station.web.camera_feed import CameraFeed
from jezero.services.ground_station.web.connections import (
    BODY_MAX_BYTES,
    RESPONSE_HEADERS,
    BoundedServer,
    Connections,
    Inner,
    OwnPagesOnly,
    PageTurns,
    RequestPlaces,
    WebSocket,
    WholeBodies,
)
from jezero.services.ground_station.web.data_panel import TopicWatch
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.login import Access, session_of
from jezero.services.ground_station.web.page import Page
from jezero.services.ground_station.web.recordings import PlaybackFeed, RecordingPages, Recordings

STOP_TIMEOUT_S = 1.0
RECONNECT_TIMEOUT_S = 60.0
"""A browser that is busy for 0.4 of it must connect anew; one that is away for longer gets a new page."""


class PageServer:
    """Serves the pages of one vehicle, in the thread that calls `run`.

    Args:
        listening: where the pages are served, and to whom; its settings are those of the pages too.
        router: the vehicle's router; None to show recordings only.
        recordings: a recording, or a run's folder with recordings; None for none.

    Attributes:
        address: of the pages, for a browser.

    Raises:
        OSError: the address can't be listened on.
    """

    def __init__(
        self,
        listening: Listening,
        robot: VehicleConfig,
        vehicle: str,
        router: str | None,
        recordings: Path | None = None,
    ) -> None:
        config = listening.config
        self._socket = listening_socket(config.listen, config.port)
        self.port: int = self._socket.getsockname()[1]
        self.address = listening.url(self.port)
        self._feed = Feed(vehicle, router or "")
        self._is_live = router is not None
        self._topics = TopicWatch(self._feed)
        self._camera = CameraFeed(robot, config.rate_camera_hz)
        shapes = robot_shapes(robot)
        insecure = insecurities(listening, router)
        site = FastAPI(lifespan=self._life, docs_url=None, redoc_url=None, openapi_url=None)
        site.add_api_route("/camera.jpg", self._send_picture)
        site.add_api_route("/coverage.webp", self._send_coverage)
        access = Access(listening)
        access.add_routes(site)

        def show_recording(feed: PlaybackFeed, pictures: str, request: Request) -> None:
            Page(feed, access, session_of(request), shapes, config, pictures)

        RecordingPages(Recordings(recordings), show_recording).add_routes(site)

        @ui.page("/", title=f"{vehicle} · jezero", dark=True)
        def show(request: Request) -> Response | None:
            if router is None:
                return RedirectResponse("/recordings")
            Page(self._feed, access, session_of(request), shapes, config, watch=self._topics, insecure=insecure)
            return None

        pages.on_connect(self._count_viewers)
        pages.on_disconnect(self._count_viewers)
        ui.run_with(
            site,
            tailwind=False,
            show_welcome_message=False,
            binding_refresh_interval=None,
            reconnect_timeout=RECONNECT_TIMEOUT_S,
        )
        connections = Connections()
        # A request passes the guards from the outermost to the site; a place is taken when its body has arrived.
        guarded: Inner = PageTurns(site, access.has_login)
        guarded = RequestPlaces(guarded, connections, access.has_login)
        guarded = access.with_sessions(WholeBodies(guarded))
        guarded = OwnPagesOnly(guarded, listening.serves)
        self._server = BoundedServer(_server_settings(guarded, listening), self._socket, connections)

    def run(self) -> None:
        """Serve until `stop`, or in the main thread until SIGINT or SIGTERM."""
        self._server.run()

    def run_in_thread(self) -> threading.Thread:
        """Start to serve in a thread of its own."""
        thread = threading.Thread(target=self.run, name="pages", daemon=True)
        thread.start()
        return thread

    def stop(self, thread: threading.Thread) -> None:
        """End the thread of `run_in_thread`."""
        self._server.should_exit = True
        thread.join(STOP_TIMEOUT_S)

    def health(self) -> Health:
        """Whether the pages can be opened, and where."""
        if not self._server.started:
            return Health("starting", f"the pages start on {self.address}")
        number = self._feed.viewers
        viewers = "nobody looks" if number == 0 else f"{number} open page{'s' if number > 1 else ''}"
        return Health("ok", f"{self.address}, {viewers}")

    def _count_viewers(self) -> None:
        self._feed.set_viewers(sum(client.has_socket_connection for client in Client.instances.values()))

    @asynccontextmanager
    async def _life(self, site: FastAPI) -> Any:
        connecting = asyncio.create_task(self._feed.connect() if self._is_live else asyncio.sleep(0))
        yield
        connecting.cancel()
        with suppress(asyncio.CancelledError):
            await connecting
        self._camera.close()
        self._topics.close()
        await self._feed.close()

    async def _send_picture(self) -> Response:
        uav = self._feed.uav
        picture = None if uav is None else await self._camera.picture(uav)
        if picture is None:
            return Response(status_code=204)
        kind = {"X-Picture": "preview"} if self._camera.shows_previews else {}
        return Response(picture, media_type="image/jpeg", headers=kind)

    async def _send_coverage(self) -> Response:
        picture = self._feed.coverage_map.picture
        return Response(picture, media_type="image/webp") if picture else Response(status_code=204)


def _server_settings(guarded: Inner, listening: Listening) -> uvicorn.Config:
    return uvicorn.Config(
        guarded,
        headers=RESPONSE_HEADERS,
        log_level="warning",
        timeout_graceful_shutdown=1,
        ssl_certfile=listening.config.certificate or None,
        ssl_keyfile=listening.config.key or None,
        ws=WebSocket,
        ws_max_size=BODY_MAX_BYTES,
        ws_ping_interval=None,  # the pages have pings of their own
        proxy_headers=False,
        server_header=False,
    )
