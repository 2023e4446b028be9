"""The panel of the simulator, where the vehicle has one: time, wind, places, faults."""

from collections.abc import Awaitable, Callable
from functools import partial

from nicegui import ui

from jezero.aio import Vehicle
from jezero.schemas.simulator import FAULTS, ActiveFault, SimulatorState
from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.feed import Feed

SPEEDS = (0.1, 0.5, 1.0, 2.0, 5.0)
FIELD = "dense outlined hide-bottom-space"


class SimulatorPanel:
    """The panel of one page; it is there while a simulator replies."""

    def __init__(self, feed: Feed, commands: Commands) -> None:
        self._feed, self._commands = feed, commands
        self._shown: tuple[ActiveFault, ...] = ()
        with ui.element("section").classes("card sim-card").props('data-mark="simulator"') as self._card:
            with ui.element("div").classes("sim-row"):
                ui.label("Simulator").classes("card-title")
                self._time = ui.label().classes("field-hint").props('data-mark="sim-time"')
            with ui.element("div").classes("sim-row"):
                self._pause = self._button("Pause", "sim-pause", self._pause_or_resume)
                self._button("Step 1 s", "sim-step", lambda: self._do("Step", lambda uav: uav.simulator.step(1.0)))
                self._button("Reset", "sim-reset", lambda: self._do("Reset", lambda uav: uav.simulator.reset()))
                self._speed = ui.select({speed: f"{speed:g} x" for speed in SPEEDS}, value=1.0, label="Speed")
                self._speed.props(f'{FIELD} data-mark="sim-speed"').on("update:model-value", self._set_speed)
            with ui.element("div").classes("sim-row"):
                self._mean = ui.number("Wind, m/s", value=0.0, min=0.0, max=30.0).props(f'{FIELD} data-mark="sim-wind"')
                self._from = ui.number("from, °", value=0.0, min=-360.0, max=360.0)
                self._from.props(f'{FIELD} data-mark="sim-wind-from"')
                self._gusts = ui.number("gusts, m/s", value=0.0, min=0.0, max=10.0)
                self._gusts.props(f'{FIELD} data-mark="sim-gusts"')
                self._button("Blow", "sim-blow", self._blow)
            with ui.element("div").classes("sim-row"):
                self._what = ui.select(
                    ["vehicle", "rover"], value="rover", label="Put the", on_change=self._offer_height
                )
                self._what.props(f'{FIELD} data-mark="sim-what"').classes("sim-wide")
                self._north, self._east, self._height = (
                    ui.number(label, value=0.0).props(f'{FIELD} data-mark="sim-{name}"')
                    for name, label in (("north", "N, m"), ("east", "E, m"), ("height", "up, m"))
                )
                self._height.set_visibility(False)
                self._button("Put", "sim-put", self._put)
            with ui.element("div").classes("sim-row"):
                self._unit = ui.select(list(FAULTS), value="gps", label="Fault of", on_change=self._offer_kinds)
                self._unit.props(f'{FIELD} data-mark="sim-unit"')
                self._kind = ui.select(list(FAULTS["gps"]), value="off", label="kind")
                self._kind.props(f'{FIELD} data-mark="sim-kind"')
                self._button("Fail", "sim-fail", self._fail)
            self._faults = ui.element("div").classes("sim-faults").props('data-mark="sim-faults"')
        self._card.set_visibility(False)
        self._filled = False

    def refresh(self) -> None:
        """Show the state of the simulator; called about twice a second."""
        state = self._feed.simulator
        self._card.set_visibility(state is not None)
        if state is None:
            return
        if not self._filled:  # the fields begin with what blows and goes now; later they are the person's
            self._filled = True
            self._mean.set_value(state.wind_mean_mps)
            self._from.set_value(state.wind_from_deg)
            self._gusts.set_value(state.std_gust_mps)
            north_m, east_m, _ = state.pos_rover_ned_m
            self._north.set_value(round(north_m, 1))
            self._east.set_value(round(east_m, 1))
            self._speed.set_value(min(SPEEDS, key=lambda speed: abs(speed - state.speed)))
        self._pause.set_text("Resume" if state.paused else "Pause")
        self._time.set_text(_time_in_words(state))
        if state.faults != self._shown:
            self._shown = state.faults
            self._show_faults(state.faults)

    def _show_faults(self, faults: tuple[ActiveFault, ...]) -> None:
        self._faults.clear()
        with self._faults:
            for fault in faults:
                name = f"{fault.unit}{f' {fault.instance}' if fault.instance else ''}"
                with ui.element("div").classes("sim-row"):
                    ui.label(f"{name} {fault.kind}").classes("sim-fault")
                    self._button("End", f"sim-end-{fault.unit}", partial(self._end, fault))

    def _button(self, text: str, mark: str, click: Callable[[], Awaitable[None]]) -> ui.button:
        return ui.button(text, on_click=click, color=None).props(f'no-caps dense data-mark="{mark}"')

    # -- clicks --

    async def _do(self, name: str, request: Callable[[Vehicle], Awaitable[SimulatorState]], done: str = "") -> None:
        await self._commands.simulate(name, request, done)

    async def _pause_or_resume(self) -> None:
        if self._feed.simulator is not None and self._feed.simulator.paused:
            await self._do("Resume", lambda uav: uav.simulator.resume(), "The simulator goes on")
        else:
            await self._do("Pause", lambda uav: uav.simulator.pause(), "The simulator is paused")

    async def _set_speed(self) -> None:
        speed = float(self._speed.value or 1.0)
        await self._do("Speed", lambda uav: uav.simulator.speed(speed), f"The simulator's speed is {speed:g}")

    async def _blow(self) -> None:
        mean_mps, from_deg, gusts_mps = (float(each.value or 0.0) for each in (self._mean, self._from, self._gusts))
        done = f"Wind of {mean_mps:g} m/s from {from_deg:g}°"
        await self._do("Wind", lambda uav: uav.simulator.wind(mean_mps, from_deg, std_gust_mps=gusts_mps), done)

    async def _put(self) -> None:
        what = self._what.value
        north_m, east_m, height_m = (float(each.value or 0.0) for each in (self._north, self._east, self._height))
        height_m = height_m if what == "vehicle" else 0.0
        await self._do(
            "Put",
            lambda uav: uav.simulator.place(north_m, east_m, height_m=height_m, what=what),
            f"The {what} is {north_m:g} m north and {east_m:g} m east of the start",
        )

    async def _fail(self) -> None:
        unit, kind = self._unit.value, self._kind.value
        await self._do("Fault", lambda uav: uav.simulator.fault(unit, kind), f"{unit} is {kind}")

    async def _end(self, fault: ActiveFault) -> None:
        await self._do(
            "Fault", lambda uav: uav.simulator.fault(fault.unit, "ok", instance=fault.instance), f"{fault.unit} is ok"
        )

    def _offer_height(self) -> None:
        self._height.set_visibility(self._what.value == "vehicle")

    def _offer_kinds(self) -> None:
        kinds = list(FAULTS[self._unit.value])
        self._kind.set_options(kinds, value=kinds[0])


def _time_in_words(state: SimulatorState) -> str:
    at = f"{state.t_ns / 1e9:.1f} s"
    return f"{at}, paused" if state.paused else f"{at}, {state.speed_reached or state.speed:g} x real time"
