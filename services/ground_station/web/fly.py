"""The panel from which goals are sent: a tab for each action of the stack, and the area that is drawn on the map."""

from collections.abc import Callable, Sequence
from typing import Any

from nicegui import events, ui

from jezero.area_files import AreaFileError, FilePolygon
from jezero.schemas.actions import PlanReply
from jezero.services.ground_station.drawn_area import DrawnArea, area_from_browser, placed, polygons_in
from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.elements import Map, View3D
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.form import Form
from jezero.services.ground_station.web.playback_feed import PlaybackFeed
from jezero.services.ground_station.web.stack_actions import StackActions
from jezero.services.ground_station.web.toast import show_toast

KEPT_TIMEOUT_S = 120.0
"""A browser without a graphics card may be busy with its first view in space for long."""


class FlyPanel:
    """The forms of one page. The map's clicks go to the form of the open tab.

    Args:
        show_map: shows the map instead of the view in space.

    Attributes:
        area: the area that is drawn.
    """

    def __init__(
        self,
        feed: Feed | PlaybackFeed,
        commands: Commands,
        chart: Map,
        view: View3D,
        show_map: Callable[[], None],
    ) -> None:
        self.area = DrawnArea()
        self._feed, self._commands = feed, commands
        self._actions = feed.actions if isinstance(feed, Feed) else StackActions(feed.state)
        self._map, self._view, self._show_map = chart, view, show_map
        self._forms: dict[str, Form] = {}
        self._open: Form | None = None
        self._tabs: ui.tabs | None = None
        self._wanted = ""
        """Tab that the browser has kept, for the time when its action is known."""
        self._recalled = False
        """The browser has sent what it has kept, which must not be overwritten before."""
        self._version = 0
        self._path: list[list[float]] = []
        self._drawn: list[list[float]] = []
        with ui.element("section").classes("card fly-card") as self._card:
            ui.label("Forms").classes("card-title")
        chart.on("point", self._on_point)
        view.on("point", self._on_point)
        chart.on("area", self._on_area)
        chart.on("file", self._on_file)
        chart.on("export", self._export)

    def refresh(self) -> None:
        """Follow the actions of the stack, and the world's origin; called about twice a second."""
        if self._actions.version != self._version:
            self._version = self._actions.version
            self._build()
        if self._open is not None:
            self._open.expire()
        path = self._feed.state.goals.drawing()["path"] or self._path
        if path != self._drawn:
            self._drawn = path
            self._view.run_method("setPlan", path)
        area = self.area.around(self._feed.state.origin_deg)
        if self._recalled and area is not self.area:
            moved = area.rings != self.area.rings
            self.area = area
            self._map.run_method("keep", "area", area.kept())
            if moved:
                self.withdraw()
                self._map.run_method("setArea", area.rings)

    def _build(self) -> None:
        """Make the forms anew; what was typed is lost, which happens only when an action has changed."""
        actions = self._actions
        opened = self._open.action.name if self._open is not None else self._wanted
        opened = opened if opened in actions.names else actions.names[0]
        self._card.clear()
        with self._card:
            with ui.tabs().props("dense no-caps") as self._tabs:
                for name in actions.names:
                    ui.tab(name, label=name.replace("_", " ")).props(f'data-mark="tab-{name}"')
            with ui.tab_panels(self._tabs, value=opened).props("keep-alive"):
                for name in actions.names:
                    with ui.tab_panel(name):
                        self._forms[name] = Form(actions.action(name), actions.description(name), self._commands, self)
        self._tabs.on_value_change(self._on_tab)
        self._open_form(opened)

    # -- what the forms show --

    @property
    def rover_ned_m(self) -> Sequence[float] | None:
        """Position of the rover; None while it is not known."""
        return self._feed.state.rover_ned_m

    @property
    def start_z_ned_m(self) -> float:
        """z of the place from which heights are counted."""
        return self._feed.state.start_z_ned_m

    def show_plan(self, plan: PlanReply | None, origin_m: Sequence[float]) -> None:
        """Draw a plan on the map at once, and in space unless a goal is flown there.

        Args:
            origin_m: origin of the plan's frame in the world.
        """
        self._path = [] if plan is None else [list(point_m) for point_m in plan.path_ned_m]
        coverage = None if plan is None else plan.coverage
        places_m = () if coverage is None else coverage.pictures_ned_m
        pictures = [[north_m + origin_m[0], east_m + origin_m[1]] for north_m, east_m in places_m]
        self._map.run_method("setPlan", {"path": self._path, "pictures": pictures})

    def show_point(self) -> None:
        """Draw the point that the open form has."""
        form = self._open
        point_m = None if form is None else form.point
        if form is not None and point_m is not None and form.in_rover_frame:
            rover_m = self._feed.state.rover_ned_m
            point_m = None if rover_m is None else [a + b for a, b in zip(point_m, rover_m, strict=False)]
        self._map.run_method("setPoint", point_m)
        self._view.run_method("setPoint", point_m)
        if form is not None:
            self._map.run_method("setMode", form.picks)

    async def _on_tab(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._map.run_method("keep", "tab", event.value)
        self._open_form(event.value)
        form = self._forms[event.value]
        if form.draws_area:
            self._show_map()
            if form.plan is None and len(self.area.outline) > 2:
                await form.make_plan()

    def withdraw(self) -> None:
        """Withdraw what waits for its confirmation."""
        if self._open is not None:
            self._open.withdraw()

    def _open_form(self, name: str) -> None:
        self.withdraw()
        self._open = self._forms[name]
        self.show_point()

    # -- clicks --

    def _on_point(self, event: events.GenericEventArguments) -> None:
        if self._open is None:
            return
        north_m, east_m = (float(part) for part in event.args)
        if self._open.in_rover_frame:
            rover_m = self._feed.state.rover_ned_m
            if rover_m is None:
                show_toast("warning", "The rover's position is not known: choose the frame world, or type the point")
                return
            north_m, east_m = round(north_m - rover_m[0], 2), round(east_m - rover_m[1], 2)
        self._open.set_point(north_m, east_m)
        self.show_point()

    # -- the area --

    async def recall(self) -> str:
        """Take what the browser has kept from before the page was loaded again; returns the view, "" for none."""
        try:
            kept = await self._map.run_method("kept", timeout=KEPT_TIMEOUT_S)
        except TimeoutError:  # the page was closed
            return ""
        self._recalled = True
        if not isinstance(kept, dict):
            return ""
        area = kept.get("area")
        if isinstance(area, dict) and area.get("rings"):
            self.area = area_from_browser(area["rings"], area.get("origin")).around(self._feed.state.origin_deg)
            self._map.run_method("setArea", self.area.rings)
        self._wanted = str(kept.get("tab") or "")
        if self._tabs is not None and self._wanted in self._forms:
            self._tabs.set_value(self._wanted)
        return str(kept.get("view") or "")

    async def _on_area(self, event: events.GenericEventArguments) -> None:
        await self._take(area_from_browser(event.args, self._feed.state.origin_deg))

    async def _take(self, area: DrawnArea) -> None:
        self.area = area
        self._map.run_method("keep", "area", area.kept())
        if self._open is not None and self._open.draws_area:
            await self._open.on_area()

    async def _on_file(self, event: events.GenericEventArguments) -> None:
        try:
            found = polygons_in(str(event.args["name"]), str(event.args["text"]), int(event.args["size"]))
            chosen = found[0] if len(found) == 1 else await self._choose(found)
            if chosen is None:
                return
            area = placed(chosen, self._feed.state.origin_deg)
        except AreaFileError as error:
            show_toast("warning", str(error))
            return
        self._map.run_method("setArea", area.rings)
        await self._take(area)

    async def _choose(self, found: list[FilePolygon]) -> FilePolygon | None:
        """Let the person choose one of several areas of a file."""
        with ui.dialog() as dialog, ui.card():
            ui.label(f"The file has {len(found)} areas. Which one?")
            for polygon in found:
                ui.button(polygon.name or polygon.place, on_click=lambda polygon=polygon: dialog.submit(polygon))
        chosen: FilePolygon | None = await dialog
        dialog.delete()
        return chosen

    def _export(self) -> None:
        try:
            ui.download.content(self.area.geojson(), "area.geojson")
        except AreaFileError as error:
            show_toast("warning", str(error))
