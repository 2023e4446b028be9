"""The page's pictures of the camera: images, or previews where no images arrive; nothing while nobody looks."""

import asyncio
import io
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh
from PIL import Image

from jezero.aio import Vehicle
from jezero.base.camera_preview import preview_of
from jezero.base.codec import encode, split_attachment
from jezero.base.vehicle_config import VehicleConfig
from jezero.base.zenoh_client import declare_publisher, put
from jezero.schemas import topics
from jezero.schemas.rows import Topic
from jezero.schemas.sensors import CameraFrame
from jezero.services.ground_station.web import camera_feed
from jezero.services.ground_station.web.camera_feed import RETRY_S, CameraFeed
from tests.aio.rig import with_vehicle
from tests.client.rig import Server, endpoint, server

pytestmark = pytest.mark.process

__all__ = ["endpoint", "server"]

TOPICS: tuple[Topic[Any], ...] = (topics.CAMERA, topics.CAMERA_PREVIEW)
FRAME = CameraFrame(
    t_ns=7,
    sequence=1,
    width_px=640,
    height_px=480,
    pitch_camera_rad=-1.5,
    exposure_s=0.004,
    pixels=bytes(3 * 640 * 480),
)
WHOLE, SMALL = (640, 480), (480, 360)


class CameraOnBus:
    """Publishes frames and previews 20 times a second, while the one and the other are on.

    Attributes:
        on: topics that are published.
    """

    def __init__(self, server: Server) -> None:
        self.on: set[Topic[Any]] = set()
        self._publishers = {topic.name: self._publisher(server, topic) for topic in TOPICS}
        self._stop = threading.Event()

    @staticmethod
    def _publisher(server: Server, topic: Topic[Any]) -> zenoh.Publisher:
        drop = zenoh.CongestionControl.DROP
        return declare_publisher(server.session, topics.key("v", topic.name), attached=True, congestion=drop)

    @contextmanager
    def publishing(self) -> Iterator[None]:
        thread = threading.Thread(target=self._publish)
        thread.start()
        yield
        self._stop.set()
        thread.join()

    def subscribed(self) -> set[str]:
        """Names of the topics to which somebody has subscribed."""
        status: dict[str, Any] = {name: each.matching_status for name, each in self._publishers.items()}
        return {name for name, each in status.items() if each.matching}

    def _publish(self) -> None:
        data = {topics.CAMERA.name: encode(FRAME), topics.CAMERA_PREVIEW.name: encode(preview_of(FRAME))}
        while not self._stop.wait(0.05):
            for topic in list(self.on):
                put(self._publishers[topic.name], data[topic.name], attached=True)


@pytest.fixture
def camera(server: Server, monkeypatch: pytest.MonkeyPatch) -> Iterator[CameraOnBus]:
    monkeypatch.setattr(camera_feed, "FRAME_TIMEOUT_S", 0.4)
    monkeypatch.setattr(camera_feed, "RETRY_S", 0.02)
    monkeypatch.setattr(camera_feed, "PICTURE_AGE_MAX_S", 0.6)
    monkeypatch.setattr(camera_feed, "LOOKER_TIMEOUT_S", 1.0)
    on_bus = CameraOnBus(server)
    with on_bus.publishing():
        yield on_bus


def with_feed(endpoint: str, server: Server, test: Callable[[CameraFeed, Vehicle], Awaitable[None]]) -> None:
    async def run(uav: Vehicle) -> None:
        feed = CameraFeed(VehicleConfig(), rate_hz=15.0)
        try:
            await test(feed, uav)
        finally:
            feed.close()

    with_vehicle(endpoint, server, run)


async def looks_until(feed: CameraFeed, uav: Vehicle, wanted: tuple[int, int] | None) -> None:
    """Ask for pictures as a page does, until one has the wanted size, or there is none."""
    while True:
        picture = await feed.picture(uav)
        if picture is None and wanted is None:
            return
        if picture is not None:
            with Image.open(io.BytesIO(picture)) as image:
                if image.size == wanted:
                    return
        await asyncio.sleep(0.02)


def test_images_are_shown_where_they_arrive_and_previews_are_not_even_read(
    endpoint: str, server: Server, camera: CameraOnBus
) -> None:
    async def test(feed: CameraFeed, uav: Vehicle) -> None:
        camera.on = set(TOPICS)
        for _ in range(20):
            await looks_until(feed, uav, WHOLE)
            assert camera.subscribed() <= {topics.CAMERA.name}
            await asyncio.sleep(0.05)

    with_feed(endpoint, server, test)


def test_previews_are_shown_where_no_images_arrive_and_images_as_soon_as_they_do(
    endpoint: str, server: Server, camera: CameraOnBus
) -> None:
    async def test(feed: CameraFeed, uav: Vehicle) -> None:
        camera.on = {topics.CAMERA_PREVIEW}
        await looks_until(feed, uav, SMALL)
        camera.on = set(TOPICS)
        await looks_until(feed, uav, WHOLE)
        while topics.CAMERA_PREVIEW.name in camera.subscribed():
            await looks_until(feed, uav, WHOLE)
        camera.on = {topics.CAMERA_PREVIEW}
        await looks_until(feed, uav, SMALL)

    with_feed(endpoint, server, test)


def test_a_new_look_where_previews_are_shown_begins_with_previews(
    endpoint: str, server: Server, camera: CameraOnBus
) -> None:
    async def test(feed: CameraFeed, uav: Vehicle) -> None:
        camera.on = {topics.CAMERA_PREVIEW}
        await looks_until(feed, uav, SMALL)
        assert feed.shows_previews
        while camera.subscribed():
            await asyncio.sleep(0.02)
        await feed.picture(uav)
        await asyncio.sleep(2 * RETRY_S)
        assert topics.CAMERA_PREVIEW.name in camera.subscribed()
        camera.on = set(TOPICS)
        await looks_until(feed, uav, WHOLE)
        assert not feed.shows_previews

    with_feed(endpoint, server, test)


def test_without_images_and_previews_there_is_no_picture(endpoint: str, server: Server, camera: CameraOnBus) -> None:
    async def test(feed: CameraFeed, uav: Vehicle) -> None:
        camera.on = {topics.CAMERA_PREVIEW}
        await looks_until(feed, uav, SMALL)
        camera.on = set()
        await looks_until(feed, uav, None)

    with_feed(endpoint, server, test)


def test_nothing_is_read_while_nobody_looks(endpoint: str, server: Server, camera: CameraOnBus) -> None:
    async def test(feed: CameraFeed, uav: Vehicle) -> None:
        camera.on = {topics.CAMERA_PREVIEW}
        assert not camera.subscribed()
        await looks_until(feed, uav, SMALL)
        assert camera.subscribed() == {topic.name for topic in TOPICS}
        while camera.subscribed():
            await asyncio.sleep(0.02)

    with_feed(endpoint, server, test)


def test_an_invalid_preview_is_passed_over(endpoint: str, server: Server, camera: CameraOnBus) -> None:
    async def test(feed: CameraFeed, uav: Vehicle) -> None:
        camera.on = {topics.CAMERA_PREVIEW}
        await looks_until(feed, uav, SMALL)
        header, _ = split_attachment(encode(preview_of(FRAME)))
        for _ in range(3):
            server.session.put(topics.key("v", topics.CAMERA_PREVIEW.name), b"no jpeg", attachment=header)
        camera.on = set()
        await looks_until(feed, uav, None)
        camera.on = {topics.CAMERA_PREVIEW}
        await looks_until(feed, uav, SMALL)

    with_feed(endpoint, server, test)


def test_outlines_are_in_the_same_place_of_image_and_preview() -> None:
    corners = [(200.0, 100.0), (400.0, 100.0), (400.0, 300.0), (200.0, 300.0)]
    places = []
    for jpeg in (
        camera_feed._marked_frame(FRAME, [corners]),
        camera_feed._marked_preview(preview_of(FRAME), [corners]),
    ):
        with Image.open(io.BytesIO(jpeg)) as image:
            rows, columns = np.nonzero(np.asarray(image.convert("RGB"))[..., 1] > 100)
            width_px, height_px = image.size
        down, right = rows / height_px, columns / width_px
        places.append([down.min(), down.max(), right.min(), right.max()])
    assert places[0] == pytest.approx([100 / 480, 300 / 480, 200 / 640, 400 / 640], abs=0.01)
    assert places[1] == pytest.approx(places[0], abs=0.01)


def test_a_preview_without_tags_is_shown_as_it_came() -> None:
    preview = preview_of(msgspec.structs.replace(FRAME, t_ns=1))
    assert camera_feed._marked_preview(preview, []) is preview.jpeg
