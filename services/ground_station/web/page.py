"""The one page: what the vehicle does, where it is, how it is, and what it should do."""

from typing import Any

from nicegui import events, ui

from jezero.base.router_address import is_on_this_computer
from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.views import ground_shape
from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.data_panel import DataPanel, TopicWatch
from jezero.services.ground_station.web.elements import (
    STATIC,
    Backpressure,
    CameraPicture,
    Events,
    HoldButton,
    Horizon,
    Instruments,
    Keys,
    MapView,
    RoverPad,
    Services,
    TargetView,
    View3D,
    Watchdog,
)
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.fly import FlyPanel
from jezero.services.ground_station.web.login import Access, AccessBar
from jezero.services.ground_station.web.recordings import RECORDED, PlaybackBar, PlaybackFeed
from jezero.services.ground_station.web.simulator_panel import SimulatorPanel

SLOW = 5
"""What changes slowly is updated in every fifth period."""
MAIN = 6
"""So many readings stand beside the horizon, the others below."""
VIEWS = {"3d": "3D", "map": "Map"}
CAMERAS = {"follow": "Follow", "top": "From above", "free": "Free"}
ROVER_SPEEDS_MPS = (0.2, 0.5, 1.0)
ROVER_YAW_RATE_RPS = 0.4
"""Yaw rate at the left and right edges of the pad."""


class GoalBar:
    """The bar of one page; it also draws the goal, and the images that it has taken, on the map."""

    def __init__(self, feed: Feed | PlaybackFeed, commands: Commands, chart: MapView) -> None:
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


class RoverPanel:
    """The pad of one page, with a choice of speeds."""

    def __init__(self, commands: Commands) -> None:
        self._commands = commands
        with ui.element("section").classes("card rover-card"):
            ui.label("Rover").classes("card-title")
            with ui.element("div").classes("rover-drive"):
                RoverPad().on("drive", self._drive).on("release", commands.release)
                with ui.element("div"):
                    speeds = {speed_mps: f"{speed_mps:g} m/s" for speed_mps in ROVER_SPEEDS_MPS}
                    self._speed = ui.toggle(speeds, value=ROVER_SPEEDS_MPS[1]).props("no-caps dense unelevated")
                    ui.label(
                        "Hold the knob and pull it: up drives, to the side turns. It stops when you let go."
                    ).classes("field-hint")

    async def _drive(self, event: events.GenericEventArguments) -> None:
        speed, turn = (max(-1.0, min(1.0, float(part))) for part in event.args)
        top_mps = float(self._speed.value)
        await self._commands.steer(speed * top_mps, turn * ROVER_YAW_RATE_RPS)


class Page:
    """One open page."""

    def __init__(
        self,
        feed: Feed | PlaybackFeed,
        access: Access,
        session: str,
        robot: dict[str, Any],
        config: GroundStationConfig,
        pictures: str = "/camera.jpg",
        watch: TopicWatch | None = None,
        insecure: str = "",
    ) -> None:
        self._feed = feed
        self._backpressure = Backpressure(ui.context.client)
        self._pictures = pictures
        self._watch = watch
        self._access, self._session = access, session
        self._robot = robot
        self._commands = Commands(feed, self._refusal)
        self._count = 0
        self._ground_version = 0
        self._period_camera_s = 1.0 / config.rate_camera_hz
        ui.add_css(STATIC / "style.css")
        ui.add_css(STATIC / "fly.css")
        ui.query("body").classes("ground")
        keys = Keys()
        with ui.element("div").classes("page") as self._whole:
            if insecure:
                ui.label(insecure).classes("insecure").props('data-mark="insecure" role=alert')
            with ui.element("div").classes("top"):
                self._header()
                self._notice_bar()
            with ui.element("main").classes("main"):
                self._stage()
                self._target = TargetView(self._robot)
                self._side()
            if isinstance(feed, PlaybackFeed):
                keys.on("hover", PlaybackBar(feed).toggle)
                self._whole.classes("recorded")
            else:
                keys.on("hover", self._commands.hover).on("abort", self._commands.abort)
                keys.on("close", self._fly.withdraw)
        ui.timer(1.0 / config.rate_hz, self._refresh)
        ui.timer(0.1, self._recall, once=True)

    # -- layout --

    def _header(self) -> None:
        with ui.element("header").classes("bar"):
            with ui.element("div").classes("state"):
                Watchdog()
                self._words = ui.label().classes("state-words").props('data-mark="state"')
                with ui.element("div").classes("state-more"):
                    self._charge = ui.label().classes("state-charge")
                    self._why = ui.label().classes("state-why")
            with ui.element("div").classes("bar-buttons"):
                if isinstance(self._feed, PlaybackFeed):
                    ui.label(f"Recording {self._feed.flight.path.name}").classes("recorded-words").props(
                        'data-mark="recorded"'
                    )
                    ui.link("Others", "/recordings").classes("recordings-link")
                else:
                    ui.link("Recordings", "/recordings").classes("recordings-link").props('data-mark="recordings"')
                self._bar = AccessBar(self._access, self._session, self._whole)
                ui.button("Hover", on_click=self._commands.hover, color=None).classes("hover-button").props(
                    "no-caps"
                ).props('data-mark="hover"')
                ui.button("Abort", on_click=self._commands.abort, color=None).classes("abort-button").props(
                    "no-caps"
                ).props('data-mark="abort"')
                HoldButton(self._commands.kill_words).on("held", self._commands.kill)

    def _notice_bar(self) -> None:
        with ui.element("div").classes("notice").props("role=alert") as self._notice:
            self._notice_words = ui.label().props('data-mark="notice"')
            ui.button("Noted", on_click=self._commands.take_note, color=None).props('no-caps dense data-mark="noted"')
        self._notice.set_visibility(False)

    def _stage(self) -> None:
        with ui.element("section").classes("stage"):
            self._view = View3D(self._robot).classes("layer").on("ready", self._draw_ground)
            self._map = MapView(self._robot).classes("layer layer-off")
            # over a radio the images of a coverage are fetched only when asked for
            self._map.show_photos(isinstance(self._feed, Feed) and is_on_this_computer(self._feed.router))
            self._map.on("photos", lambda event: self._map.show_photos(bool(event.args)))
            with ui.element("div").classes("stage-tools"):
                self._which = ui.toggle(VIEWS, value="3d", on_change=self._switch).props("no-caps dense unelevated")
                self._angle = ui.toggle(CAMERAS, value="follow", on_change=self._aim).props("no-caps dense unelevated")
            with ui.element("details").classes("picture").props("open"):
                with ui.element("summary"):
                    ui.label("Camera")
                CameraPicture(self._pictures, self._period_camera_s)
            self._goal = GoalBar(self._feed, self._commands, self._map)

    def _side(self) -> None:
        with ui.element("aside").classes("side"):
            with ui.element("section").classes("card instruments"):
                self._horizon = Horizon()
                self._readings = Instruments().classes("readings-main")
                self._details = Instruments().classes("readings-more")
            self._fly = FlyPanel(self._feed, self._commands, self._map, self._view, self._show_map)
            if isinstance(self._feed, Feed):
                RoverPanel(self._commands)
                self._simulator = SimulatorPanel(self._feed, self._commands)
            with ui.element("section").classes("card"):
                ui.label("Events").classes("card-title")
                self._events = Events()
            with ui.element("section").classes("card"):
                ui.label("Services").classes("card-title")
                self._services = Services()
            if self._watch is not None:
                DataPanel(self._watch)

    def _refusal(self) -> str:
        """Why this page may not fly now; "" if it may."""
        return RECORDED if isinstance(self._feed, PlaybackFeed) else self._bar.refusal()

    # -- refresh --

    def _refresh(self) -> None:
        if not self._backpressure.may_send():
            return
        now_s, state = self._feed.now_s, self._feed.state
        line = state.status_line(now_s, self._feed.problem)
        self._words.set_text(line["words"])
        self._words.classes(replace=f"state-words tone-{line['tone']}")
        charge = f"in charge: {line['charge']} {line['since']}" if line["charge"] else ""
        self._charge.set_text(charge)
        notice = state.notice(now_s) if isinstance(self._feed, Feed) else ""  # nobody has to take note of a recording
        self._notice.set_visibility(bool(notice))
        self._notice_words.set_text(notice)
        self._why.set_text("" if notice and line["tone"] == "bad" else line["why"])  # the notice says it already
        lost = line["tone"] == "lost"
        self._whole.classes("vehicle-silent" if lost else "", remove="" if lost else "vehicle-silent")
        scene = state.scene(now_s)
        self._view.run_method("update", scene)
        self._map.run_method("update", scene)
        self._horizon.show(scene["vehicle"])
        self._target.show(state.landing(now_s))
        if self._count % 2 == 0:
            rows = state.readings(now_s)
            self._readings.show(rows[:MAIN])
            self._details.show(rows[MAIN:])
        if self._count % SLOW == 0:
            self._refresh_slowly(now_s)
        self._count += 1

    def _refresh_slowly(self, now_s: float) -> None:
        state = self._feed.state
        if self._ground_version != self._feed.ground_version:
            self._ground_version = self._feed.ground_version
            self._draw_ground()
        self._bar.show()
        trail = state.trail()
        self._view.run_method("setTrail", trail)
        self._map.run_method("setTrail", trail)
        self._map.run_method("setFence", state.fence())
        self._view.run_method("setPhotos", state.photos())
        self._events.show(state.event_rows(now_s))
        self._services.show(state.services(now_s))
        self._fly.refresh()
        if isinstance(self._feed, Feed):
            self._simulator.refresh()
        self._goal.refresh(now_s, self._which.value == "map")

    # -- views --

    async def _recall(self) -> None:
        if await self._fly.recall() == "map":
            self._show_map()

    def _draw_ground(self) -> None:
        self._view.run_method("setGround", ground_shape(self._feed.ground))

    def _show_map(self) -> None:
        self._which.set_value("map")

    def _switch(self) -> None:
        shows_map = self._which.value == "map"
        self._map.classes(remove="layer-off") if shows_map else self._map.classes("layer-off")
        self._view.classes("layer-off") if shows_map else self._view.classes(remove="layer-off")
        self._angle.set_visibility(not shows_map)
        self._map.run_method("keep", "view", self._which.value)

    def _aim(self) -> None:
        self._view.run_method("setMode", self._angle.value)
