"""The page's own elements: a Vue component each, in `static/`."""

from pathlib import Path
from typing import Any

from nicegui.element import Element
from nicegui.elements import scene as _three  # noqa: F401 - registers three.js, which NiceGUI ships

STATIC = Path(__file__).parent / "static"


class View3D(
    Element,
    component="static/view3d.js",
    esm={"jezero-models": "static/models", "jezero-ground-click": "static/ground_click"},
):
    """Vehicle, rover and ground in space; it emits `point` for a click on the ground."""

    def __init__(self, robot: dict[str, Any]) -> None:
        super().__init__()
        self.props["robot"] = robot


class Target(Element, component="static/target.js"):
    """The target view of a landing."""

    def __init__(self, robot: dict[str, Any]) -> None:
        super().__init__()
        self.props["side"] = robot["platform"]["side"]

    def show(self, landing: dict[str, Any] | None) -> None:
        """Show a landing; None hides the view."""
        if self.props.get("landing") != landing:
            self.props["landing"] = landing


class Map(Element, component="static/map.js", esm={"jezero-area": "static/area"}):
    """The map from above; it emits `point`, `area`, `file` (of an area), `export` and `photos`."""

    def __init__(self, robot: dict[str, Any]) -> None:
        super().__init__()
        self.props["robot"] = robot

    @property
    def shows_photos(self) -> bool:
        """Whether the images of a goal are shown on the ground."""
        return bool(self.props.get("photos"))

    def show_photos(self, shows: bool) -> None:
        """Show the images of a goal on the ground, or not."""
        self.props["photos"] = shows


class RoverPad(Element, component="static/rover_pad.js"):
    """A pad that drives the rover while it is held; it emits `drive` with two parts from -1 to 1, and `release`."""


class Readings(Element, component="static/readings.js"):
    """Values with their ages."""

    def show(self, rows: list[dict[str, Any]]) -> None:
        """Show these rows."""
        if self.props.get("rows") != rows:
            self.props["rows"] = rows


class Horizon(Element, component="static/horizon.js"):
    """Artificial horizon and compass."""

    def show(self, attitude: dict[str, Any] | None) -> None:
        """Show an attitude, with `roll`, `pitch` and `yaw` in degrees; None for none."""
        if self.props.get("attitude") != attitude:
            self.props["attitude"] = attitude


class Camera(Element, component="static/camera.js"):
    """The camera's picture."""

    def __init__(self, address: str, period_s: float) -> None:
        super().__init__()
        self.props["address"] = address
        self.props["period_ms"] = round(1000.0 * period_s)


class Keys(Element, component="static/keys.js"):
    """Space and Esc, wherever the focus is; it emits `hover`, `abort`, and `close` for a goal to be confirmed."""


class HoldButton(Element, component="static/hold_button.js"):
    """A button that must be held for a second; it emits `held`."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.props["text"] = text


class Watchdog(Element, component="static/watchdog.js"):
    """Says in the place of the state that nothing comes from the server any more, and turns the page grey."""
