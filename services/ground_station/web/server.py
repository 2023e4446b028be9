"""The web server of the pages, on this machine's loopback address."""

import asyncio
import socket
import threading
from collections.abc import Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from fastapi import FastAPI, Response
from nicegui import Client, ui
from nicegui import app as pages

from jezero.runtime.service import Health
from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.robot import robot_shapes
from jezero.services.ground_station.web.camera_feed import CameraFeed
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.page import Page
from jezero.vehicle_config import VehicleConfig

HOST = "127.0.0.1"
LOOPBACK = frozenset({"127.0.0.1", "localhost", "[::1]"})
PORTS_TRIED = 20
STOP_TIMEOUT_S = 1.0
RECONNECT_TIMEOUT_S = 30.0
"""A browser that is busy for longer gets a new page."""
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]


def listening_socket(port: int) -> socket.socket:
    """A socket that listens on a port of the loopback address, or on one of the next ports when that is busy.

    Raises:
        OSError: none of them is free.
    """
    for candidate in (*range(port, min(port + PORTS_TRIED, 65536)), 0):
        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, candidate))
            listening.listen()
        except OSError:
            listening.close()
            continue
        return listening
    raise OSError(f"no free port on {HOST}")


class OwnPagesOnly:
    """Refuses what another site's page sends: a browser would pass it on with the user's own address.

    A page of another site names itself in `Origin`; one that has pointed its own name at this machine in `Host`.
    """

    def __init__(self, inner: Callable[[Any, Receive, Send], Awaitable[None]]) -> None:
        self._inner = inner

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
            host, origin = headers.get(b"host", ""), headers.get(b"origin")
            if host.rpartition(":")[0] not in LOOPBACK or (origin is not None and urlsplit(origin).netloc != host):
                await _refuse(scope, receive, send)
                return
        await self._inner(scope, receive, send)


async def _refuse(scope: Any, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
    else:
        await Response("only this machine's own pages are served", status_code=403)(scope, receive, send)


class PageServer:
    """Serves the pages of one vehicle, in the thread that calls `run`.

    Attributes:
        address: of the pages, for a browser.
    """

    def __init__(self, config: GroundStationConfig, robot: VehicleConfig, vehicle: str, router: str) -> None:
        self._socket = listening_socket(config.port)
        self.port: int = self._socket.getsockname()[1]
        self.address = f"http://{HOST}:{self.port}"
        self._feed = Feed(vehicle, router)
        self._camera = CameraFeed(robot, config.rate_camera_hz)
        shapes = robot_shapes(robot)
        site = FastAPI(lifespan=self._life, docs_url=None, redoc_url=None, openapi_url=None)
        site.add_api_route("/camera.jpg", self._send_picture)
        site.add_api_route("/coverage.webp", self._send_coverage)

        @ui.page("/", title=f"{vehicle} · jezero", dark=True)
        def show() -> None:
            Page(self._feed, shapes, config.rate_hz, config.rate_camera_hz)

        pages.on_connect(self._count_viewers)
        pages.on_disconnect(self._count_viewers)
        ui.run_with(
            site,
            tailwind=False,
            show_welcome_message=False,
            binding_refresh_interval=None,
            reconnect_timeout=RECONNECT_TIMEOUT_S,
        )
        settings = uvicorn.Config(OwnPagesOnly(site), log_level="warning", timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(settings)

    def run(self) -> None:
        """Serve until `stop`, or in the main thread until SIGINT or SIGTERM."""
        self._server.run(sockets=[self._socket])

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
        connecting = asyncio.create_task(self._feed.connect())
        yield
        connecting.cancel()
        with suppress(asyncio.CancelledError):
            await connecting
        self._camera.close()
        await self._feed.close()

    async def _send_picture(self) -> Response:
        uav = self._feed.uav
        picture = None if uav is None else await self._camera.picture(uav)
        return Response(status_code=204) if picture is None else Response(picture, media_type="image/jpeg")

    async def _send_coverage(self) -> Response:
        picture = self._feed.coverage_map.picture
        return Response(picture, media_type="image/webp") if picture else Response(status_code=204)
