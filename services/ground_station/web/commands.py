"""What the buttons do: every command is a request of the SDK, and its outcome is a sentence."""

import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from jezero.aio import JezeroError, Refused, Vehicle, Wheel
from jezero.schemas.actions import PlanReply
from jezero.schemas.rows import Action
from jezero.schemas.simulator import SimulatorState
from jezero.services.ground_station.web.elements import show_toast
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.recordings import PlaybackFeed
from jezero.services.ground_station.words import Tone


class Commands:
    """The commands of one page. All of them reach the vehicle by `_uav`: there is none for a page that may not fly.

    Args:
        feed: the connection to the vehicle.
        refusal: returns why the page may not fly now, "" if it may; called for each command.

    Attributes:
        sent: ids of the goals that were sent from this page.
    """

    def __init__(self, feed: Feed | PlaybackFeed, refusal: Callable[[], str]) -> None:
        self._feed = feed
        self._refusal = refusal
        self.sent: set[str] = set()
        self._wheel = Wheel()
        self._drives = False

    @property
    def _uav(self) -> Vehicle | None:
        """The vehicle; None for a page that may not fly, or without a connection."""
        return None if self._refusal() else self._feed.uav

    @property
    def _problem(self) -> str:
        """Why there is no vehicle."""
        return self._refusal() or self._feed.problem

    async def hover(self) -> None:
        """Hover here, which ends the goal in charge."""
        await self._request("Hover", lambda uav: uav.hover(), "The vehicle hovers")

    async def abort(self) -> None:
        """End the goal in charge at once."""
        await self._request("Abort", lambda uav: uav.abort("abort from the ground station"), "Aborted")

    async def pause_or_resume(self) -> None:
        """Pause the goal in charge, or go on with it when it is paused."""
        if self._feed.state.paused:
            await self._request("Resume", lambda uav: uav.resume(), "The goal goes on")
        else:
            await self._request("Pause", lambda uav: uav.pause(), "The goal is paused: the vehicle hovers until Resume")

    @property
    def kill_words(self) -> str:
        """Words on the button that kills: in the air the name is the second confirmation."""
        return f"Kill {self._feed.vehicle} (hold)"

    async def kill(self) -> None:
        """Stop the motors, also in the air: the button that was held names the vehicle."""
        name = self._feed.vehicle
        await self._request("Kill", lambda uav: uav.kill(confirm=True, vehicle=name), "The motors are stopped")

    async def take_note(self) -> None:
        """Take note of what ended the last flight, for all pages."""
        if refusal := self._refusal():
            self._note("bad", f"Noted failed: {refusal}")
        elif (end := self._feed.state.flight_end.newest) is not None:
            self._feed.state.flight_end.take_note()
            self._feed.state.events.add(time.monotonic(), "plain", f"Noted: {end.words}")

    async def cancel(self, action: str, goal_id: str, owner: str) -> None:
        """Cancel a goal of whichever client; its owner is named in words."""
        words = action.replace("_", " ")
        name = f"{words} ({owner})" if owner else words
        done = f"{name} is canceled: the vehicle hovers"
        await self._request(f"Cancel of {name}", lambda uav: uav.actions.cancel(action, goal_id), done)

    async def send(self, action: Action[Any], fields: Mapping[str, Any]) -> str:
        """Send a goal; returns "" when it is accepted, else the reason of the refusal."""
        uav = self._uav
        if uav is None:
            return self._problem
        name = action.name.replace("_", " ")
        try:
            goal = await uav.send(action, **fields)
        except (JezeroError, ValueError) as error:
            reason = str(error).removeprefix(f"{action.name}: ")
            self._note("warning", f"{name} was refused: {reason}")
            return reason
        self.sent.add(goal.goal_id)
        self._note("good", f"{name} was accepted")
        if goal.warning:
            self._note("warning", goal.warning)
        return ""

    async def plan(self, action: Action[Any], fields: Mapping[str, Any]) -> PlanReply:
        """The plan of a goal that is not flown, or its refusal."""
        uav = self._uav
        if uav is None:
            return PlanReply(accepted=False, reason=self._problem)
        try:
            return await uav.plan(action, **fields)
        except (JezeroError, ValueError) as error:
            return PlanReply(accepted=False, reason=str(error).removeprefix(f"{action.name}: "))

    async def simulate(self, name: str, request: Callable[[Vehicle], Awaitable[SimulatorState]], done: str) -> None:
        """Change the simulated world, and keep its new state for all pages."""

        async def change(uav: Vehicle) -> None:
            state = await request(uav)
            if isinstance(self._feed, Feed):
                self._feed.simulator = state

        await self._request(f"{name} of the simulator", change, done)

    # -- rover --

    async def steer(self, speed_mps: float, yaw_rate_rps: float) -> None:
        """Drive the rover until `release`, or until no other call comes within half a second."""
        if self._refusal():  # a log-in that has ended during a drive
            self._wheel.release()
            await self._request("Driving the rover", lambda uav: uav.rover.steer(self._wheel), "")
            return
        try:
            self._wheel.turn(speed_mps, yaw_rate_rps)
        except ValueError as error:
            self._note("warning", str(error))
            return
        if not self._drives:
            self._drives = True
            try:
                await self._request("Driving the rover", lambda uav: uav.rover.steer(self._wheel), "")
            finally:
                self._drives = False

    def release(self) -> None:
        """Stop the rover."""
        self._wheel.release()

    async def _request(self, name: str, request: Callable[[Vehicle], Awaitable[object]], done: str) -> None:
        uav = self._uav
        try:
            if uav is None:
                raise Refused(self._problem)
            await request(uav)
        except JezeroError as error:
            self._note("bad", f"{name} failed: {error}")
        else:
            if done:
                self._note("good", done)

    def _note(self, tone: Tone, text: str) -> None:
        if not self._refusal():  # who watches writes nothing into the list that all pages show
            self._feed.state.events.add(time.monotonic(), tone, text)
        show_toast(tone, text)
