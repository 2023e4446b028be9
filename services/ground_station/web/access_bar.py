"""Shows on a page who may fly, with the ways to log in and out."""

from nicegui import ui
from nicegui.element import Element

from jezero.services.ground_station.web.access import WATCHING, Access
from jezero.services.ground_station.web.elements import STATIC
from jezero.services.ground_station.words import duration

WARN_S = 120.0
"""The page warns of the end of its log-in this long before it."""


class Activity(Element, component="static/activity.js"):
    """Emits `used` now and then while somebody uses the page."""


class AccessBar:
    """Who may fly from one page.

    Args:
        page: the page's outermost element, whose class `watching` hides the commands.
        session: id of the page's session.
    """

    def __init__(self, access: Access, session: str, page: Element) -> None:
        self._access, self._session, self._page = access, session, page
        self._shown: tuple[bool, str] | None = None
        ui.add_css(STATIC / "access.css")
        if not access.needs_login:
            return
        Activity().on("used", lambda: access.use(session))
        with ui.element("div").classes("access"):
            self._words = ui.label().classes("access-words").props('data-mark="access"')
            self._log_in = ui.link("Log in", "/login").props('data-mark="log-in"')
            with ui.element("form").props("method=post action=/logout") as self._log_out:
                ui.html("<button data-mark='log-out'>Log out</button>", sanitize=False)
        self.show()

    def refusal(self) -> str:
        """Why the page may not fly now; "" if it may, which counts as use."""
        return "" if self._access.use(self._session) else WATCHING

    def show(self) -> None:
        """Show whether the page may fly, and when that ends."""
        if not self._access.needs_login:
            return
        remaining_s = self._access.remaining_s(self._session)
        flies = remaining_s > 0.0
        words = "Watching" if not flies else f"log-in ends in {duration(remaining_s)}" if remaining_s < WARN_S else ""
        if (flies, words) == self._shown:
            return
        self._shown = (flies, words)
        self._words.set_text(words)
        self._log_in.set_visibility(not flies)
        self._log_out.set_visibility(flies)
        self._page.classes(remove="watching") if flies else self._page.classes("watching")
