"""The goal in charge, whichever client sent it: its progress over the map, with a button that cancels it."""

from typing import Any

from nicegui import ui

from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.elements import Map
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.playback_feed import PlaybackFeed


class GoalBar:
    """The bar of one page; it also draws the goal, and the images that it has taken, on the map."""

    def __init__(self, feed: Feed | PlaybackFeed, commands: Commands, chart: Map) -> None:
        self._feed, self._commands, self._map = feed, commands, chart
        self._goal: dict[str, Any] | None = None
        self._changes = -1
        self._photos = -1
        with ui.element("div").classes("progress") as self._bar:
            with ui.element("div").classes("goal"):
                self._text = ui.label().props('data-mark="goal"')
                self._owner = ui.label().classes("goal-owner").props('data-mark="goal-owner"')
            self._done = ui.linear_progress(0.0, show_value=False).props("rounded")
            self._pause = ui.button("Pause", on_click=commands.pause_or_resume, color=None)
            self._pause.props('no-caps dense data-mark="pause"').classes("pause-button")
            ui.button("Cancel", on_click=self._cancel, color=None).props('no-caps dense data-mark="goal-cancel"')
        self._bar.set_visibility(False)

    def refresh(self, now_s: float, shows_map: bool) -> None:
        """Show the goal; called about twice a second."""
        state = self._feed.state
        uav = self._feed.uav
        goal = state.goals.progress(now_s, "" if uav is None else uav.client_id, self._commands.sent)
        self._goal = goal
        self._bar.set_visibility(goal is not None)
        if goal is not None:
            self._text.set_text(f"{goal['words']} · {goal['text']}")
            self._owner.set_text(goal["owner"])
            self._pause.set_text("Resume" if state.paused else "Pause")
            self._done.set_visibility(goal["done"] is not None)
            self._done.set_value(goal["done"] or 0.0)
        if state.goals.changes != self._changes:
            self._changes = state.goals.changes
            self._map.run_method("setGoal", state.goals.drawing())
        if isinstance(self._feed, Feed) and shows_map and self._map.shows_photos:
            photos = self._feed.coverage_map
            photos.look()
            if photos.version != self._photos and photos.version > 0:
                self._photos = photos.version
                self._map.run_method("setMosaic", photos.shown())

    async def _cancel(self) -> None:
        if self._goal is not None:
            await self._commands.cancel(self._goal["action"], self._goal["goal_id"], self._goal["owner"])
