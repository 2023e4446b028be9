"""The panel from which goals are sent: a form for each action, from the action's own goal type."""

from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from jezero.plugins import all_actions
from jezero.schemas.actions import PlanReply
from jezero.services.ground_station.goal_form import CORNERS_MIN, Field, form_of, goal_from
from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.elements import Map, View3D
from jezero.services.ground_station.words import duration

START: dict[str, dict[str, Any]] = {
    "go_to": {"target_ned_m": [0, 0, -3]},
    "get_images": {"center_ned_m": [0, 0, -5], "radius_m": 4, "num_images": 8},
    "area_coverage": {"z_ned_m": -4, "overlap": 0.6},
}
"""What a form has at first where the goal type has no default."""
FLIGHT_ORDER = ("takeoff", "go_to", "get_images", "area_coverage", "land_on_spot")

MANY = 4
"""A form with so many fields shows at first only those that the goal needs."""


class Form:
    """The form of one action."""

    def __init__(self, action: str, panel: "FlyPanel") -> None:
        self.action = action
        self._panel = panel
        schema = all_actions()[action].description.goal
        self.text, self.fields = form_of(schema)
        self._inputs: dict[str, list[Any]] = {}
        self._plan: PlanReply | None = None
        self._planned: dict[str, Any] | None = None
        """The goal that was sent to be planned last; the reply to an earlier one is not shown."""
        self._planning = False
        self._z_ned_m = 0.0
        self.area: list[list[float]] = []
        ui.label(self.text).classes("form-text")
        with ui.element("div").classes("form"):
            for field in self.fields:
                if len(self.fields) < MANY or field.required or field.name in START.get(action, {}):
                    self._input(field)
        rest = [field for field in self.fields if field.name not in self._inputs]
        if rest:
            with ui.expansion("More settings").classes("form-more").props("dense"), ui.element("div").classes("form"):
                for field in rest:
                    self._input(field)
        self._problem = ui.label().classes("form-problem").props(f'data-mark="problem-{action}"')
        self._found = ui.label().classes("form-plan").props(f'data-mark="plan-{action}"')
        with ui.element("div").classes("form-buttons"):
            ui.button("Plan", on_click=self.plan).props("no-caps outline").props(f'data-mark="plan-button-{action}"')
            ui.button("Fly", on_click=self.send, color=None).props("no-caps unelevated").classes("fly").props(
                f'data-mark="fly-{action}"'
            )

    @property
    def picks(self) -> str:
        """What a click on the map means for this form: `point`, `area` or `look`."""
        kinds = {field.kind for field in self.fields}
        return "area" if "area" in kinds else "point" if "vector" in kinds else "look"

    def _input(self, field: Field) -> None:
        default = START.get(self.action, {}).get(field.name, field.default)
        label = f"{field.label}{f' ({field.unit})' if field.unit else ''}"
        mark = f"{self.action}-{field.name}"
        made: list[Any]
        if field.kind == "switch":
            made = [ui.switch(label, value=bool(default)).props(f'data-mark="{mark}"')]
        elif field.kind == "choice":
            made = [
                ui.select(list(field.choices), value=default, label=label).props("dense").props(f'data-mark="{mark}"')
            ]
        elif field.kind == "vector":
            parts = default or [None] * len(field.axes)
            with ui.element("div").classes("vector"):
                made = [
                    ui.input(f"{axis} (m)", value="" if part is None else str(part))
                    .props("dense")
                    .props(f'data-mark="{mark}-{axis}"')
                    for axis, part in zip(field.axes, parts, strict=True)
                ]
        elif field.kind in ("area", "areas"):
            made = []
            if field.kind == "area":
                ui.label("Click the corners of the area on the map; drag a corner to move it.").classes("form-hint")
                ui.button("Clear area", on_click=self.clear_area).props("no-caps dense flat")
        else:
            placeholder = field.range_words
            made = [
                ui.input(label, value="" if default is None else f"{default:g}", placeholder=placeholder)
                .props("dense")
                .props(f'data-mark="{mark}"')
            ]
        for element in made:
            element.tooltip(field.help)
            element.on("keydown.enter", self.send)
        self._inputs[field.name] = made

    def clear_area(self) -> None:
        """Begin the area again."""
        self.area, self._planned = [], None
        self._panel.show_area(self.area)
        self._show_plan(None)

    def on_point(self, north_m: float, east_m: float) -> None:
        """Take a point of the map as the target."""
        vector = next((field for field in self.fields if field.kind == "vector"), None)
        if vector is not None:
            for element, part in zip(self._inputs[vector.name], (north_m, east_m), strict=False):
                element.set_value(f"{part:g}")

    async def on_area(self, area: list[list[float]]) -> None:
        """Take an area of the map, and show its plan."""
        self.area, self._planned = area, None
        self._show_plan(None)
        if len(area) >= CORNERS_MIN:
            await self.plan()

    def _goal(self) -> dict[str, Any] | None:
        values: dict[str, Any] = {}
        for field in self.fields:
            inputs = self._inputs[field.name]
            if field.kind == "area":
                values[field.name] = self.area
            elif field.kind == "vector":
                values[field.name] = [element.value for element in inputs]
            elif inputs:
                values[field.name] = inputs[0].value
        goal, problems = goal_from(self.fields, values)
        self._problem.set_text(". ".join(problems.values()))
        return None if problems else goal

    async def plan(self) -> None:
        """Plan the goal, and show what it would take.

        The server plans one goal at a time and refuses another: a goal that changes meanwhile is planned afterwards.
        """
        self._planned = self._goal()
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
            self._z_ned_m = goal.get("z_ned_m", 0.0)
            self._found.set_text("planning …")
            found = await self._panel.commands.plan(self.action, goal)
            if self._planned is goal:
                self._problem.set_text(found if isinstance(found, str) else found.reason)
                self._show_plan(None if isinstance(found, str) else found)
                return
        self._show_plan(None)

    async def send(self) -> None:
        """Send the goal."""
        goal = self._goal()
        if goal is None:
            return
        if self._plan is not None and self._plan.coverage is not None and self._planned == goal:
            goal = goal | {"plan_id": self._plan.coverage.plan_id}
        self._problem.set_text(await self._panel.commands.send(self.action, goal))

    def _show_plan(self, plan: PlanReply | None) -> None:
        self._plan = plan
        self._found.set_text("" if plan is None else plan_words(plan))
        self._panel.show_plan(plan, self._z_ned_m)


def plan_words(plan: PlanReply) -> str:
    """What a goal would take: images, length, time and battery."""
    parts = []
    if plan.coverage is not None:
        parts.append(f"{len(plan.coverage.pictures_ned_m)} images")
        parts.append(f"{100.0 * plan.coverage.photographed:.0f} % of the area in them")
    if plan.distance_m is not None:
        parts.append(f"{plan.distance_m:.0f} m")
    if plan.duration_s is not None:
        parts.append(duration(plan.duration_s))
    if plan.battery_used is not None:
        parts.append(f"{100.0 * plan.battery_used:.0f} % of the battery")
    return " · ".join(parts) + (f". {plan.warning}" if plan.warning else "")


class FlyPanel:
    """A tab for each action. The map's clicks go to the form of the open tab."""

    def __init__(self, commands: Commands, chart: Map, view: View3D, show_map: Callable[[], None]) -> None:
        self.commands = commands
        self._map, self._view, self._show_map = chart, view, show_map
        self._forms: dict[str, Form] = {}
        names = sorted(all_actions(), key=lambda name: (*FLIGHT_ORDER, name).index(name))
        with ui.element("section").classes("card fly-card"):
            with ui.tabs().props("dense no-caps") as tabs:
                for name in names:
                    ui.tab(name, label=name.replace("_", " ")).props(f'data-mark="tab-{name}"')
            with ui.tab_panels(tabs, value=names[0]).props("keep-alive"):
                for name in names:
                    with ui.tab_panel(name):
                        self._forms[name] = Form(name, self)
        self._open = self._forms[names[0]]
        tabs.on_value_change(self._on_tab)
        chart.on("point", self._on_point)
        chart.on("area", self._on_area)

    def show_area(self, area: list[list[float]]) -> None:
        """Draw an area on the map."""
        self._map.run_method("setArea", area)

    def show_plan(self, plan: PlanReply | None, z_ned_m: float) -> None:
        """Draw a plan on the map, and in space at its height."""
        coverage = None if plan is None else plan.coverage
        path = [] if coverage is None else [list(point_m) for point_m in coverage.path_ned_m]
        pictures = [] if coverage is None else [list(point_m) for point_m in coverage.pictures_ned_m]
        self._map.run_method("setPlan", {"path": path, "pictures": pictures})
        self._view.run_method("setPlan", [[*point_m, z_ned_m] for point_m in path])

    def _on_tab(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._open = self._forms[event.value]
        self._map.run_method("setMode", self._open.picks)
        if self._open.picks == "area":
            self._show_map()
        self.show_area(self._open.area)

    def _on_point(self, event: events.GenericEventArguments) -> None:
        self._open.on_point(*event.args)

    async def _on_area(self, event: events.GenericEventArguments) -> None:
        await self._open.on_area(event.args)
