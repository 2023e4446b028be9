"""A vehicle through the SDK, for all pages: its messages, its actions, and the map of its images."""

import asyncio
import time
from contextlib import suppress
from typing import Any

from jezero.aio import JezeroError, Vehicle, described
from jezero.base.plugins import PluginError, action_names, find_action
from jezero.base.router_address import shown_router
from jezero.runtime.instance import links_from_environment
from jezero.schemas.actions import ActionDescription, FeedbackMessage
from jezero.schemas.health import ServiceHealth
from jezero.schemas.rows import Action, Topic
from jezero.schemas.simulator import SimulatorState
from jezero.schemas.terrain import Ground
from jezero.services.ground_station.goals import GoalView
from jezero.services.ground_station.growing_map import GrowingMap, MapPlace
from jezero.services.ground_station.state import ALWAYS, WATCHED, ShownState

ALL_FEEDBACK: Topic[FeedbackMessage[dict[str, Any]]] = Topic(
    "action/*/feedback", FeedbackMessage[dict[str, Any]], 10.0, "every action server"
)
ALL_HEALTH = Topic("health/*", ServiceHealth, 1.0, "every service")
RETRY_S = 1.0
SILENT_S = 5.0
"""Time without a status after which the keys are asked for the reason, and between two such checks."""
CONNECT_TIMEOUT_S = 3.0
SIMULATOR_PERIOD_S = 1.0
FOLLOW_PERIOD_S = 0.2
DESCRIPTIONS_RETRY_S = 2.0
FLIGHT_ORDER = ("takeoff", "go_to", "get_images", "area_coverage", "land_on_spot", "return_home")
LOOKER_TIMEOUT_S = 3.0
ENCODE_PERIOD_S = 1.0
"""Least time between two pictures of the map for the pages."""
ENCODE_SHARE = 0.1
"""Largest fraction of the time that is spent on them."""


class StackActions:
    """The actions of one vehicle's stack; those that are installed here until it has replied.

    They are asked for their descriptions at the start, and when a service has appeared or was restarted.

    Attributes:
        version: grows when the descriptions change.
    """

    def __init__(self, state: ShownState) -> None:
        self.version = 1
        self._state = state
        self._actions: dict[str, tuple[ActionDescription, Action[Any]]] = {}
        for name in action_names():
            with suppress(PluginError):  # a broken package: the stack may have a good one
                self._actions[name] = (find_action(name).description, find_action(name))
        self._runs: dict[str, int] | None = None
        self._next_s = 0.0

    @property
    def names(self) -> list[str]:
        """Names of the actions for which there is a form, in the order of a flight, those of packages last."""
        names = (name for name, (_, action) in self._actions.items() if action.steered_by is None)
        return sorted(names, key=lambda name: ((*FLIGHT_ORDER, name).index(name), name))

    def description(self, name: str) -> ActionDescription:
        """The description of an action, as the action publishes it."""
        return self._actions[name][0]

    def action(self, name: str) -> Action[Any]:
        """The row of the topic table of an action."""
        return self._actions[name][1]

    async def follow(self, uav: Vehicle) -> None:
        """Keep the descriptions and the goal in charge up to date, until the task is canceled."""
        while True:
            with suppress(JezeroError):  # the link is lost: the page shows it, and all is asked again later
                await self._ask(uav, time.monotonic())
            await asyncio.sleep(FOLLOW_PERIOD_S)

    async def _ask(self, uav: Vehicle, now_s: float) -> None:
        runs = dict(self._state.runs)
        if runs != self._runs and now_s >= self._next_s:
            self._next_s = now_s + DESCRIPTIONS_RETRY_S
            found = await uav.actions.descriptions()
            self._runs = runs if found else None
            self._keep(found)
        if self._state.goals.wants_running(now_s):
            self._state.goals.on_running(await uav.actions.running())

    def _keep(self, found: list[ActionDescription]) -> None:
        """Keep new descriptions; those of servers that do not reply now stay, and their goals are refused with why."""
        for description in found:
            known = self._actions.get(description.name)
            if known is None or known[0] != description:
                self._actions[description.name] = (description, described(description))
                self.version += 1


class CoverageMap:
    """The growing map of one vehicle. One image is fetched at a time, and drawn in a thread.

    Attributes:
        version: grows with each new picture of the map.
        place: where the picture lies; None without one.
        picture: the newest picture, WebP.
        problem: why an image is missing; "" for none.
    """

    def __init__(self, state: ShownState, actions: StackActions) -> None:
        self.version = 0
        self.place: MapPlace | None = None
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
                await asyncio.sleep(FOLLOW_PERIOD_S)
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


class Feed:
    """The connection to one vehicle, for NiceGUI's event loop.

    Attributes:
        state: what arrived.
        actions: the actions of the stack.
        coverage_map: the map of the images of the goal in charge.
        problem: why there is no connection yet, or why none of the vehicle's messages come over TLS; "" for neither.
        ground: ground of the simulator; None while nobody has looked, and without a simulator.
        simulator: state of the simulator; None while nobody has looked, and without one.
        ground_version: grows with each reply to a request for the ground, also with one that there is none.
    """

    def __init__(self, vehicle: str, router: str) -> None:
        self.state = ShownState()
        self.actions = StackActions(self.state)
        self.coverage_map = CoverageMap(self.state, self.actions)
        self.vehicle, self.router = vehicle, router
        self.ground: Ground | None = None
        self.simulator: SimulatorState | None = None
        self.ground_version = 0
        self.problem = f"Connecting to {shown_router(router)} …"
        self._uav: Vehicle | None = None
        self._always: list[asyncio.Task[None]] = []
        self._watching: list[asyncio.Task[None]] = []
        self._viewers = 0

    @property
    def uav(self) -> Vehicle | None:
        """The vehicle; None until a router replies."""
        return self._uav

    @property
    def now_s(self) -> float:
        """Present time, of the clock of `state`."""
        return time.monotonic()

    @property
    def viewers(self) -> int:
        """Number of open pages."""
        return self._viewers

    # -- life --

    async def connect(self) -> None:
        """Connect, and read what is always read. Returns when a router has replied."""
        while self._uav is None:
            try:
                self._uav = await Vehicle.connect(self.vehicle, router=self.router, insecure=True)  # as it was started
            except JezeroError as error:
                self.problem = str(error)
                await asyncio.sleep(RETRY_S)
        self.problem = ""
        self._always = [self._reading(topic) for topic in (ALL_FEEDBACK, ALL_HEALTH, *ALWAYS)]
        self._always += [
            asyncio.create_task(follow(self._uav)) for follow in (self.actions.follow, self.coverage_map.follow)
        ]
        self._always.append(asyncio.create_task(self._check_keys()))
        self._watch()

    async def close(self) -> None:
        """End all tasks and the connection."""
        for task in (*self._always, *self._watching):
            task.cancel()
        if self._uav is not None:
            await self._uav.close()

    def set_viewers(self, number: int) -> None:
        """Read what the pages show while there are any."""
        self._viewers = number
        self._watch()

    def _watch(self) -> None:
        if self._viewers > 0 and not self._watching and self._uav is not None:
            self._watching = [self._reading(topic) for topic in WATCHED]
            self._watching.append(asyncio.create_task(self._ask_for_ground()))
            self._watching.append(asyncio.create_task(self._follow_simulator()))
        elif self._viewers == 0:
            for task in self._watching:
                task.cancel()
            self._watching = []

    async def _ask_for_ground(self) -> None:
        """Ask for the ground once, and again when the vehicle was restarted: its simulator may be another one."""
        assert self._uav is not None
        asked_in: int | None = -1
        while True:
            if asked_in != self.state.epoch_id:
                asked_in = self.state.epoch_id
                try:
                    self.ground = await self._uav.ground()
                except JezeroError:  # a real vehicle: it has no simulator
                    self.ground = None
                self.ground_version += 1
            await asyncio.sleep(RETRY_S)

    async def _follow_simulator(self) -> None:
        """Ask for the simulator's state once a second, where it has shown its ground."""
        assert self._uav is not None
        while True:
            if self.ground is None:
                self.simulator = None
            else:
                try:
                    self.simulator = await self._uav.simulator.state()
                except JezeroError:  # it restarts, or these keys may only watch
                    self.simulator = None
            await asyncio.sleep(SIMULATOR_PERIOD_S)

    async def _check_keys(self) -> None:
        """Find out why no status comes over TLS: the router of this computer hides that its keys are revoked."""
        routers = [each for each in (self.router, *links_from_environment().connect) if each.startswith("tls/")]
        while routers:
            await asyncio.sleep(SILENT_S)
            self.problem = "" if self.state.has_status(self.now_s, SILENT_S) else await self._silence(*routers)

    async def _silence(self, *routers: str) -> str:
        """Why the vehicle's status isn't to be had from a router over TLS, the first one with a reason; or ""."""
        for router in routers:
            try:
                async with await Vehicle.connect(self.vehicle, router=router, timeout_s=CONNECT_TIMEOUT_S) as uav:
                    await uav.status()
            except JezeroError as error:
                return str(error)
        return ""

    # -- messages --

    def _reading(self, topic: Topic[Any]) -> asyncio.Task[None]:
        return asyncio.create_task(self._read(topic))

    async def _read(self, topic: Topic[Any]) -> None:
        assert self._uav is not None
        async with self._uav.subscribe(topic) as stream:
            while True:
                try:
                    message = await stream.next()
                except JezeroError as error:
                    self.state.events.add(time.monotonic(), "warning", f"{topic.name}: {error}")
                    await asyncio.sleep(RETRY_S)
                else:
                    self.state.update(time.monotonic(), topic, message)
