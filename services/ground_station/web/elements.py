"""What the panels of a page share: elements of its own, a Vue component each in `static/`; short messages; and the rule
of how much is sent to a page that does not read.
"""

import time
from pathlib import Path
from typing import Any

from nicegui import Client, ui
from nicegui.element import Element
from nicegui.elements import scene as _three  # noqa: F401 - registers three.js, which NiceGUI ships

from jezero.services.ground_station.words import Tone, in_words

STATIC = Path(__file__).parent / "static"
TOAST_KINDS = {"good": "positive", "plain": "info", "warning": "warning", "bad": "negative"}
TOAST_TIMEOUT_MS = 6000
UNREAD_MAX = 400
"""Messages, about ten seconds of them. A page acknowledges what it has read every three seconds."""
TRICKLE_PERIOD_S = 2.0


class View3D(
    Element,
    component="static/view3d.js",
    esm={"jezero-models": "static/models", "jezero-ground-click": "static/ground_click"},
):
    """Vehicle, rover and ground in space; it emits `point` for a click on the ground."""

    def __init__(self, robot: dict[str, Any]) -> None:
        super().__init__()
        self.props["robot"] = robot


class TargetView(Element, component="static/target.js"):
    """The target view of a landing."""

    def __init__(self, robot: dict[str, Any]) -> None:
        super().__init__()
        self.props["side"] = robot["platform"]["side"]

    def show(self, landing: dict[str, Any] | None) -> None:
        """Show a landing; None hides the view."""
        set_changed(self, "landing", landing)


class MapView(Element, component="static/map.js", esm={"jezero-area": "static/area"}):
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


class Instruments(Element, component="static/readings.js"):
    """Values with their ages."""

    def show(self, rows: list[dict[str, Any]]) -> None:
        """Show these rows."""
        set_changed(self, "rows", rows)


class Horizon(Element, component="static/horizon.js"):
    """Artificial horizon and compass."""

    def show(self, attitude: dict[str, Any] | None) -> None:
        """Show an attitude, with `roll`, `pitch` and `yaw` in degrees; None for none."""
        set_changed(self, "attitude", attitude)


class CameraPicture(Element, component="static/camera.js"):
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


class Events(Element, component="static/events.js"):
    """The last events in words, the newest first, each with a mark in front: colours alone tell nothing."""

    def show(self, rows: list[dict[str, Any]]) -> None:
        """Show these rows."""
        set_changed(self, "rows", rows)


class Services(Element, component="static/services.js"):
    """Each service with its state and its sentence, and a mark in front."""

    def show(self, rows: list[dict[str, Any]]) -> None:
        """Show these rows."""
        set_changed(self, "rows", rows)


def set_changed(element: Element, name: str, value: Any) -> None:
    """Set a property of an element if it has changed: each assignment is sent to the browser."""
    if element.props.get(name) != value:
        element.props[name] = value


def show_toast(tone: Tone, text: str) -> None:
    """Show a message at the bottom, where neither the state nor the buttons that stop the vehicle are."""
    ui.notify(in_words(text), type=TOAST_KINDS[tone], position="bottom", timeout=TOAST_TIMEOUT_MS, multi_line=True)  # type: ignore[arg-type]


class Backpressure:
    """Decides whether more is sent to one page: little to one that is asleep or stalled.

    Without this rule, what a page doesn't read is kept until its connection times out. The little that is sent brings
    an acknowledgement from a page that reads again, or whose last one was lost with a connection.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._trickled_s = 0.0

    def may_send(self) -> bool:
        """Whether to send the next values; one that is not sent is not sent later either."""
        if not self._client.has_socket_connection:
            return False
        if len(self._client.outbox.message_history) <= UNREAD_MAX:
            return True
        now_s = time.monotonic()
        if now_s - self._trickled_s < TRICKLE_PERIOD_S:
            return False
        self._trickled_s = now_s
        return True
