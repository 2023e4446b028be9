"""The actions of the stack as they describe themselves on the bus, and the goal in charge as its server knows it."""

import asyncio
import time
from contextlib import suppress
from typing import Any

from jezero.aio import JezeroError, Vehicle, described
from jezero.plugins import PluginError, action_names, find_action
from jezero.schemas.actions import ActionDescription, FeedbackMessage
from jezero.schemas.rows import Action, Topic
from jezero.services.ground_station.state import VehicleState

ALL_FEEDBACK: Topic[FeedbackMessage[dict[str, Any]]] = Topic(
    "action/*/feedback", FeedbackMessage[dict[str, Any]], 10.0, "every action server"
)
PERIOD_S = 0.2
RETRY_S = 2.0
FLIGHT_ORDER = ("takeoff", "go_to", "get_images", "area_coverage", "land_on_spot", "return_home")


class StackActions:
    """The actions of one vehicle's stack; those that are installed here until it has replied.

    They are asked for their descriptions at the start, and when a service has appeared or was restarted.

    Attributes:
        version: grows when the descriptions change.
    """

    def __init__(self, state: VehicleState) -> None:
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
        """Names of the actions in the order of a flight, those of packages last."""
        return sorted(self._actions, key=lambda name: ((*FLIGHT_ORDER, name).index(name), name))

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
            await asyncio.sleep(PERIOD_S)

    async def _ask(self, uav: Vehicle, now_s: float) -> None:
        runs = dict(self._state.runs)
        if runs != self._runs and now_s >= self._next_s:
            self._next_s = now_s + RETRY_S
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
