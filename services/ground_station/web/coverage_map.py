"""The map that grows with the images of the goal in charge. Images are fetched only while a page shows the map."""

import asyncio
import time
from contextlib import suppress
from typing import Any

from jezero.aio import JezeroError, Vehicle
from jezero.services.ground_station.goals import GoalView
from jezero.services.ground_station.growing_map import GrowingMap, Place
from jezero.services.ground_station.state import VehicleState
from jezero.services.ground_station.web.stack_actions import StackActions

LOOKER_TIMEOUT_S = 3.0
PERIOD_S = 0.2
ENCODE_PERIOD_S = 1.0
"""Least time between two pictures of the map for the pages."""
ENCODE_SHARE = 0.1
"""Largest fraction of the time that is spent on them."""


class CoverageMap:
    """The growing map of one vehicle. One image is fetched at a time, and drawn in a thread.

    Attributes:
        version: grows with each new picture of the map.
        place: where the picture lies; None without one.
        picture: the newest picture, WebP.
        problem: why an image is missing; "" for none.
    """

    def __init__(self, state: VehicleState, actions: StackActions) -> None:
        self.version = 0
        self.place: Place | None = None
        self.picture = b""
        self.problem = ""
        self._state = state
        self._actions = actions
        self._looked_s = -LOOKER_TIMEOUT_S
        self._goal_id = ""
        self._map = GrowingMap()
        self._tried: set[int] = set()
        self._drawn = 0
        self._encode_at_s = 0.0

    def look(self) -> None:
        """Note that a page shows the map now."""
        self._looked_s = time.monotonic()

    def shown(self) -> dict[str, Any] | None:
        """The picture's address and place for the page; None without one."""
        place = self.place
        if place is None:
            return None
        return {
            "url": f"/coverage.webp?version={self.version}",
            "north": place.north_m, "east": place.east_m, "height": place.height_m, "width": place.width_m,
        }  # fmt: skip

    async def follow(self, uav: Vehicle) -> None:
        """Add images until the task is canceled."""
        while True:
            view = self._state.goals.view
            if view is None or time.monotonic() - self._looked_s > LOOKER_TIMEOUT_S or not await self._add(uav, view):
                await asyncio.sleep(PERIOD_S)
            await self._encode()

    async def _add(self, uav: Vehicle, view: GoalView) -> bool:
        """Fetch and draw one more image of a goal; returns False without one."""
        if not view.images or view.action not in self._actions.names:
            return False
        if view.goal_id != self._goal_id:
            self._goal_id, self._map, self._tried, self._drawn = view.goal_id, GrowingMap(), set(), 0
        index = next((index for index in sorted(view.images) if index not in self._tried), None)
        if index is None:
            return False
        self._tried.add(index)
        try:
            picture = await uav.actions.picture(self._actions.action(view.action), view.goal_id, view.images[index])
        except JezeroError as error:
            self.problem = f"image {index} is missing in the map: {error}"
            return True
        with suppress(ValueError):  # an image of another size than its description says
            await asyncio.to_thread(self._map.add, picture.image, picture.pixels)
        return True

    async def _encode(self) -> None:
        """Make a new picture of the map, if images were added and the last one is old enough."""
        start_s = time.monotonic()
        if self._map.count == self._drawn or start_s < self._encode_at_s:
            return
        self._drawn = self._map.count
        encoded = await asyncio.to_thread(self._map.encoded)
        if encoded is not None:
            self.picture, self.place = encoded
            self.version += 1
        taken_s = time.monotonic() - start_s
        self._encode_at_s = start_s + max(ENCODE_PERIOD_S, taken_s / ENCODE_SHARE)
