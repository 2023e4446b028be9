"""The panel from which goals are sent: a form for each action of the stack, and the area that is drawn on the map.

A form is made from the goal type as its action describes it on the bus. A goal takes two clicks: the first one plans it
and draws the plan, the second one confirms the plan and flies it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import events, ui

from jezero.area_files import AreaFileError, FilePolygon
from jezero.schemas.actions import ActionDescription, PlanReply
from jezero.schemas.rows import Action
from jezero.services.ground_station.drawn_area import DrawnArea, area_from_browser, placed, polygons_in
from jezero.services.ground_station.goal_form import (
    CORNERS_MIN,
    Confirmation,
    FormField,
    form_of,
    goal_from,
    named_field,
)
from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.elements import MapView, View3D, show_toast
from jezero.services.ground_station.web.feed import Feed, StackActions
from jezero.services.ground_station.web.recordings import PlaybackFeed
from jezero.services.ground_station.words import duration, in_words

START_VALUES: dict[str, dict[str, Any]] = {
    "go_to": {"target_ned_m": [None, None, 3]},
    "get_images": {"center_ned_m": [None, None, 5], "radius_m": 4, "num_images": 8},
    "area_coverage": {"z_ned_m": 4, "overlap": 0.6},
}
"""What a form has at first where the goal type has no default; heights are positive up."""
CLICKS = {
    "go_to": "Click the map or the ground: there it flies.",
    "get_images": "Click the target on the map or on the ground; it flies around it.",
}
AREA_HINT = "Click the corners on the map. Drag a corner, or the middle of an edge; a right click removes a corner."
NO_HOLES = "This action takes no holes: remove them from the area"
NO_ROVER = "The rover's position is not known: choose the frame world"
WORLD = (0.0, 0.0, 0.0)
MANY_FIELDS = 4
"""A form with so many fields shows at first only those that the goal needs."""
KEPT_TIMEOUT_S = 120.0
"""A browser without a graphics card may be busy with its first view in space for long."""


@dataclass(frozen=True)
class Case:
    """One of several kinds of a goal.

    Attributes:
        label: name of the case.
        text: what it means.
        values: fields that it sets.
        clicks: the point that the map's clicks set belongs to the goal.
    """

    label: str
    text: str
    values: Mapping[str, Any]
    clicks: bool = False


CASES: dict[str, tuple[Case, ...]] = {
    "land_on_spot": (
        Case("UWB + tags", "On the rover, with ranges and camera.", {"use_uwb": True, "use_tag": True}),
        Case("UWB", "On the rover, with ranges alone.", {"use_uwb": True, "use_tag": False}),
        Case(
            "Tags",
            "On the rover, with the camera alone: click about where the rover is.",
            {"use_uwb": False, "use_tag": True},
            clicks=True,
        ),
        Case(
            "Spot",
            "On the ground, without any sensor of the rover: click the spot.",
            {"use_uwb": False, "use_tag": False},
            clicks=True,
        ),
    )
}
"""Kinds of a goal that are chosen by one switch instead of several fields."""


class Form:
    """The form of one action.

    Attributes:
        action: the action.
        plan: the newest plan; None without one.
    """

    def __init__(
        self, action: Action[Any], description: ActionDescription, commands: Commands, panel: "FlyPanel"
    ) -> None:
        self.action = action
        self.plan: PlanReply | None = None
        self._panel = panel
        self._commands = commands
        self.text, self.fields = form_of(description.goal)
        self._inputs: dict[str, list[Any]] = {}
        self._rows: dict[str, Any] = {}
        self._problems: dict[str, Any] = {}
        self._planned: dict[str, Any] | None = None
        """The goal that was sent to be planned last; the reply to an earlier one is not shown."""
        self._planned_typed: dict[str, Any] = {}
        self._planning = False
        self._is_asked = False
        """The plan that comes next is shown with the button that confirms it."""
        self._confirmation: Confirmation | None = None
        self._origin_m: Sequence[float] | None = WORLD
        """Origin of the goal's frame in the world; None while it is not known."""
        names = {field.name for field in self.fields}
        cases = CASES.get(action.name, ())
        self._cases = {case.label: case for case in cases if set(case.values) <= names}
        self._build()

    # -- layout --

    def _build(self) -> None:
        name = self.action.name
        ui.label(self.text).classes("form-text")
        ui.label(CLICKS.get(name, "")).classes("field-hint")
        set_by_case = {field for case in self._cases.values() for field in case.values}
        shown = [field for field in self.fields if field.name not in set_by_case]
        first = [field for field in shown if self._is_first(field, len(shown))]
        with ui.element("div").classes("form"):
            if self._cases:
                self._case_switch()
            for field in first:
                self._row(field)
        rest = [field for field in shown if field not in first]
        self._more = ui.expansion("More settings").classes("form-more").props("dense")
        self._more.set_visibility(bool(rest))
        self._in_more = {field.name for field in rest}
        with self._more, ui.element("div").classes("form"):
            for field in rest:
                self._row(field)
        self._problem = ui.label().classes("form-problem").props(f'data-mark="problem-{name}"')
        self._found = ui.element("div").classes("plan").props(f'data-mark="plan-{name}"')
        self._warning = ui.label().classes("form-plan")
        with ui.element("div").classes("form-buttons"):
            self._back = ui.button("Back", on_click=self.withdraw).props(f'no-caps outline data-mark="back-{name}"')
            self._fly = ui.button("Fly", color=None).props(f'no-caps unelevated data-mark="fly-{name}"').classes("fly")
            self._fly.on("click", self.press, ["detail"])
        self._back.set_visibility(False)
        self._show_case()

    def _is_first(self, field: FormField, number: int) -> bool:
        if field.kind == "choices":
            return False
        clicked = bool(self._cases) and field.kind == "vector"
        return number < MANY_FIELDS or field.required or clicked or field.name in START_VALUES.get(self.action.name, {})

    def _case_switch(self) -> None:
        labels = list(self._cases)
        with ui.element("div").classes("form-case"):
            self._case = ui.toggle(labels, value=labels[0], on_change=self._show_case)
            self._case.props(f'no-caps dense unelevated data-mark="{self.action.name}-case"')
            self._case_text = ui.label().classes("field-hint")

    def _show_case(self) -> None:
        if not self._cases:
            return
        self.withdraw()
        case = self._cases[self._case.value]
        self._case_text.set_text(case.text)
        for field in self.fields:
            if field.kind == "vector":
                self._rows[field.name].set_visibility(case.clicks)
        self._panel.show_point()

    def _row(self, field: FormField) -> None:
        wide = field.kind in ("vector", "area", "areas", "switch")
        with ui.element("div").classes("field field-wide" if wide else "field") as row:
            self._inputs[field.name] = self._input(field)
            if field.has_height:
                rover = "; in the rover's frame, above the rover" if self._has_frame else ""
                ui.label(f"Heights are above the start{rover}.").classes("field-hint")
            problem = ui.label().classes("field-problem")
            self._problems[field.name] = problem.props(f'data-mark="problem-{self.action.name}-{field.name}"')
        self._rows[field.name] = row
        for element in self._inputs[field.name]:
            element.tooltip(field.help)
            element.on_value_change(self.withdraw)
            if self.draws_area:
                element.on("blur", self.replan)
            elif field.kind == "vector" or field.name == "frame":
                element.on_value_change(self._panel.show_point)

    def _input(self, field: FormField) -> list[Any]:
        default = START_VALUES.get(self.action.name, {}).get(field.name, field.default)
        label = f"{field.label}{f' ({field.unit})' if field.unit else ''}"
        mark = f'data-mark="{self.action.name}-{field.name}"'
        match field.kind:
            case "switch":
                return [ui.switch(label, value=bool(default)).props(mark)]
            case "choice":
                return [ui.select(list(field.choices), value=default, label=label).props("dense").props(mark)]
            case "choices":
                several = ui.select(list(field.choices), value=list(default or ()), label=label, multiple=True)
                return [several.props("dense").props(mark)]
            case "vector":
                return self._vector_input(field, default or [None] * len(field.axes))
            case "area" | "areas":
                if field.kind == "area":
                    ui.label(AREA_HINT).classes("form-hint")
                return []
        value = "" if default is None else f"{default:g}"
        hint = field.range_words or ("" if field.required or default is not None else "empty: the vehicle chooses")
        return [ui.input(label, value=value).props(f'dense hide-bottom-space hint="{hint}"').props(mark)]

    def _vector_input(self, field: FormField, parts: Sequence[float | None]) -> list[Any]:
        with ui.element("div").classes("vector"):
            return [
                ui.input(f"{axis} ({field.unit})", value="" if part is None else f"{part:g}").props(
                    f'dense data-mark="{self.action.name}-{field.name}-{axis}"'
                )
                for axis, part in zip(field.axes, parts, strict=True)
            ]

    # -- the map --

    @property
    def draws_area(self) -> bool:
        """Whether the goal has an area from the map."""
        return any(field.kind == "area" for field in self.fields)

    @property
    def picks(self) -> str:
        """What a click on the map means for this form: `point`, `area` or `look`."""
        if self.draws_area:
            return "area"
        return "look" if self._point_field is None else "point"

    @property
    def _point_field(self) -> FormField | None:
        if self._cases and not self._cases[self._case.value].clicks:
            return None
        return next((field for field in self.fields if field.kind == "vector" and field.name in self._inputs), None)

    @property
    def point(self) -> list[float] | None:
        """The point that the form has, in its frame; None without one."""
        field = self._point_field
        if field is None:
            return None
        try:
            parts = [float(element.value or 0.0) for element in self._inputs[field.name]]
        except ValueError:
            return None
        if field.has_height:
            parts[-1] = self._start_z_ned_m - parts[-1]
        return parts if all(element.value not in (None, "") for element in self._inputs[field.name][:2]) else None

    @property
    def _has_frame(self) -> bool:
        """Whether the goal's points can be relative to the rover."""
        return any(field.name == "frame" for field in self.fields)

    @property
    def in_rover_frame(self) -> bool:
        """Whether the goal's points are relative to the rover."""
        return any(field.name == "frame" and self._inputs["frame"][0].value == "rover" for field in self.fields)

    @property
    def _start_z_ned_m(self) -> float:
        """z of the place above which heights are typed, in the goal's frame."""
        return 0.0 if self.in_rover_frame else float(self._panel.start_z_ned_m)

    def set_point(self, north_m: float, east_m: float) -> None:
        """Take a point in the form's frame as the target; its height stays."""
        field = self._point_field
        if field is None:
            return
        for element, part in zip(self._inputs[field.name], (north_m, east_m), strict=False):
            element.set_value(f"{part:g}")
        if len(self._inputs[field.name]) > 2 and self._inputs[field.name][2].value in (None, ""):
            self._inputs[field.name][2].set_value("0")

    async def on_area(self) -> None:
        """Plan a new area at once."""
        self.withdraw()
        self._planned = None
        self._show_plan(None)
        if len(self._panel.area.outline) >= CORNERS_MIN:
            await self.make_plan()

    async def replan(self) -> None:
        """Plan again if the goal has changed since its plan."""
        if self.plan is not None and self._typed() != self._planned_typed:
            await self.make_plan()

    # -- the goal --

    def _typed(self) -> dict[str, Any]:
        """What the fields hold."""
        values: dict[str, Any] = {name: [each.value for each in inputs] for name, inputs in self._inputs.items()}
        return values | ({"case": self._case.value} if self._cases else {})

    def _goal(self) -> dict[str, Any] | None:
        area: DrawnArea = self._panel.area
        self._origin_m = self._panel.rover_ned_m if self.in_rover_frame else WORLD
        rings = () if self._origin_m is None else area.relative_to(self._origin_m)
        values: dict[str, Any] = {}
        for field in self.fields:
            inputs = self._inputs.get(field.name, [])
            if field.kind == "area":
                values[field.name] = rings[0] if rings else []
            elif field.kind == "areas":
                values[field.name] = list(rings[1:])
            elif field.kind == "vector":
                values[field.name] = [element.value for element in inputs] if field == self._point_field else None
            elif inputs:
                values[field.name] = inputs[0].value
        if self._cases:
            values |= self._cases[self._case.value].values
        goal, problems = goal_from(self.fields, values, self._start_z_ned_m)
        if self.draws_area and len(area.rings) > 1 and not any(field.kind == "areas" for field in self.fields):
            problems[next(field.name for field in self.fields if field.kind == "area")] = NO_HOLES
        if self.draws_area and self._origin_m is None:
            problems["frame"] = NO_ROVER
        self._show_refusal("", problems)
        if problems:
            return None
        if (
            self.draws_area
            and area.origin_deg is not None
            and self.action.name == "area_coverage"
            and not self.in_rover_frame
        ):
            goal["origin_deg"] = list(area.origin_deg)
        return goal

    def _show_refusal(self, reason: str, problems: Mapping[str, str] | None = None) -> None:
        """Show a refusal at the field that it is about, and what is wrong with fields."""
        at = named_field(reason, [field for field in self.fields if field.name in self._problems])
        shown = {at: reason} if at else dict(problems or {})
        for name, label in self._problems.items():
            label.set_text(in_words(shown.get(name, "")))
        if self._in_more & set(shown):
            self._more.open()
        self._problem.set_text("" if at else in_words(reason))

    async def make_plan(self) -> None:
        """Plan the goal, and show what it would take.

        The server plans one goal at a time and refuses another: a goal that changes meanwhile is planned afterwards.
        """
        self._planned, self._planned_typed = self._goal(), self._typed()
        if self._planned is None or self._planning:
            return
        self._planning = True
        try:
            await self._plan_newest()
        finally:
            self._planning = False

    async def _plan_newest(self) -> None:
        """Plan until the goal has not changed meanwhile."""
        while (goal := self._planned) is not None:
            self._show_items({"plan": "planning …"})
            found = await self._commands.plan(self.action, goal)
            if self._planned is goal:
                self._show_refusal(found.reason)
                self._show_plan(found if found.accepted else None)
                if self.plan is not None and self._is_asked:
                    self._ask(Confirmation(goal, self._planned_typed, self.plan, time.monotonic()))
                return
        self._show_plan(None)

    # -- the two clicks --

    async def press(self, event: events.GenericEventArguments) -> None:
        """Plan the goal and ask for a confirmation; when that is given by a click of its own, fly it.

        The second click of a double click confirms nothing, and neither does a key: `detail` counts clicks.
        """
        confirmation = self._confirmation
        if confirmation is not None and confirmation.holds_for(self._typed(), time.monotonic()):
            if event.args.get("detail") == 1:
                await self._send(confirmation)
            return
        self.withdraw()
        self._is_asked = True
        await self.make_plan()

    def withdraw(self) -> None:
        """Withdraw the goal that waits for its confirmation."""
        self._is_asked = False
        if not self.draws_area:
            self._planned = None
        if self._confirmation is not None:
            self._ask(None)
            if not self.draws_area:
                self._show_plan(None)

    def expire(self) -> None:
        """Withdraw a confirmation that is too old."""
        if self._confirmation is not None and self._confirmation.is_old(time.monotonic()):
            self.withdraw()

    def _ask(self, confirmation: Confirmation | None) -> None:
        """Show the confirmation on the button that flies; None for the button that plans."""
        self._confirmation = confirmation
        self._fly.set_text("Fly" if confirmation is None else confirmation.words(self._panel.start_z_ned_m))
        self._fly.classes("confirming") if confirmation is not None else self._fly.classes(remove="confirming")
        self._back.set_visibility(confirmation is not None)

    async def _send(self, confirmation: Confirmation) -> None:
        goal, plan = dict(confirmation.goal), confirmation.plan
        self._ask(None)
        if plan.coverage is not None:
            goal["plan_id"] = plan.coverage.plan_id
        self._show_refusal(await self._commands.send(self.action, goal))
        if plan.coverage is None:  # the way that is flown is drawn from now on
            self._show_plan(None)

    def _show_plan(self, plan: PlanReply | None) -> None:
        self.plan = plan
        self._show_items({} if plan is None else _plan_items(plan))
        self._warning.set_text("" if plan is None else in_words(plan.warning))
        self._panel.show_plan(plan, self._origin_m or WORLD)

    def _show_items(self, items: Mapping[str, str]) -> None:
        self._found.clear()
        with self._found:
            for name, text in items.items():
                with ui.element("div").classes("plan-item"):
                    ui.label(name).classes("plan-name")
                    ui.label(text).classes("plan-value")


def _plan_items(plan: PlanReply) -> dict[str, str]:
    """What a coverage would take: images, length, time and battery. Of other goals the confirmation says it all."""
    if plan.coverage is None:
        return {}
    items = {
        "images": f"{len(plan.coverage.pictures_ned_m)}",
        "photographed": f"{100.0 * plan.coverage.photographed:.0f} %",
        "line distance": f"{plan.coverage.line_distance_m:.1f} m",
    }
    if plan.distance_m is not None:
        items["length"] = f"{plan.distance_m:.0f} m"
    if plan.duration_s is not None:
        items["time"] = duration(plan.duration_s)
    if plan.battery_used is not None:
        left = "" if plan.battery_remaining is None else f" of {100.0 * plan.battery_remaining:.0f} %"
        items["battery"] = f"{100.0 * plan.battery_used:.0f} %{left}"
    return items


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
        chart: MapView,
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
                show_toast("warning", f"{NO_ROVER}, or type the point")
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
