"""The card that drives the rover by hand."""

from nicegui import events, ui

from jezero.services.ground_station.web.commands import Commands
from jezero.services.ground_station.web.elements import RoverPad

SPEEDS_MPS = (0.2, 0.5, 1.0)
YAW_RATE_RPS = 0.4
"""Yaw rate at the left and right edges of the pad."""


class RoverPanel:
    """The pad of one page, with a choice of speeds."""

    def __init__(self, commands: Commands) -> None:
        self._commands = commands
        with ui.element("section").classes("card rover-card"):
            ui.label("Rover").classes("card-title")
            with ui.element("div").classes("rover-drive"):
                RoverPad().on("drive", self._drive).on("release", commands.release)
                with ui.element("div"):
                    speeds = {speed_mps: f"{speed_mps:g} m/s" for speed_mps in SPEEDS_MPS}
                    self._speed = ui.toggle(speeds, value=SPEEDS_MPS[1]).props("no-caps dense unelevated")
                    ui.label(
                        "Hold the knob and pull it: up drives, to the side turns. It stops when you let go."
                    ).classes("field-hint")

    async def _drive(self, event: events.GenericEventArguments) -> None:
        speed, turn = (max(-1.0, min(1.0, float(part))) for part in event.args)
        top_mps = float(self._speed.value)
        await self._commands.steer(speed * top_mps, turn * YAW_RATE_RPS)
