"""Logging in and out. Whoever has not logged in only watches, where the pages can be reached from other machines."""

import asyncio
import secrets
import time
from html import escape
from typing import Any
from urllib.parse import parse_qs

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from nicegui import ui
from nicegui.element import Element
from starlette.middleware.sessions import SessionMiddleware

from jezero.services.ground_station.access import PASSWORD_LENGTH_MAX, Listening, LoginLimiter, Sessions, matches
from jezero.services.ground_station.web.connections import Inner
from jezero.services.ground_station.web.elements import STATIC
from jezero.services.ground_station.words import duration

COOKIE = "jezero_session"
SESSION = "id"
CHECKS_MAX = 4
"""Passwords that are checked or wait for it. There is one check at a time: it takes 19 MiB and one processor."""
WATCHING = "you are watching: log in to fly"
WARN_S = 120.0
"""The page warns of the end of its log-in this long before it."""


class Access:
    """The log-ins of one server.

    Starlette's cookie has a session's id: it is signed, and valid for `session_max_s`. The session itself is kept here,
    so that a log-out and the idle time end it on its open pages too.
    """

    def __init__(self, listening: Listening) -> None:
        self._listening = listening
        config = listening.config
        self._sessions = Sessions(config.session_idle_s, config.session_max_s)
        self._limiter = LoginLimiter()
        self._checking = asyncio.Lock()
        self._checks = 0

    @property
    def needs_login(self) -> bool:
        """Whether only those who have logged in may fly."""
        return bool(self._listening.password_hash)

    def remaining_s(self, session: str) -> float:
        """Time until a page may not fly any more; 0 for one that only watches."""
        return self._sessions.remaining_s(session, time.monotonic()) if self.needs_login else float("inf")

    def use(self, session: str) -> bool:
        """Note that somebody uses a page; returns whether it may fly."""
        return not self.needs_login or self._sessions.use(session, time.monotonic())

    def has_login(self, scope: Any) -> bool:
        """Whether a request is one of somebody who has logged in."""
        return self.needs_login and self.remaining_s(scope["session"].get(SESSION, "")) > 0.0

    def with_sessions(self, inner: Inner) -> Inner:
        """The same application with the sessions of its requests, which end when this server does."""
        return SessionMiddleware(
            inner,
            secret_key=secrets.token_hex(),
            session_cookie=COOKIE,
            max_age=int(self._listening.config.session_max_s),
            same_site="strict",
            https_only=bool(self._listening.config.certificate),
        )

    def add_routes(self, site: FastAPI) -> None:
        """Add the pages that log in and out."""
        site.add_api_route("/login", self._show_form, methods=["GET"])
        site.add_api_route("/login", self._log_in, methods=["POST"])
        site.add_api_route("/logout", self._log_out, methods=["POST"])

    async def _show_form(self) -> Response:
        return _form("")

    async def _log_in(self, request: Request) -> Response:
        address = "" if request.client is None else request.client.host
        wait_s = self._limiter.wait_s(address, time.monotonic())
        if wait_s > 0.0 or self._checks >= CHECKS_MAX:
            text = f"Too many attempts: wait {max(wait_s, 1.0):.0f} s." if wait_s > 0.0 else "Others log in: try again."
            return _form(text, 429)
        password = _password_in(await request.body())
        if not await self._is_right(password):
            self._limiter.on_failure(address, time.monotonic())
            return _form("The password is wrong.", 401)
        self._limiter.on_success(address)
        request.session[SESSION] = self._sessions.begin(time.monotonic())
        return RedirectResponse("/", 303)

    async def _is_right(self, password: str) -> bool:
        if not self.needs_login or not password:
            return False
        self._checks += 1
        try:
            async with self._checking:
                return await asyncio.to_thread(matches, password, self._listening.password_hash)
        finally:
            self._checks -= 1

    async def _log_out(self, request: Request) -> Response:
        self._sessions.end(session_of(request))
        request.session.clear()
        return RedirectResponse("/", 303)


def session_of(request: Request) -> str:
    """The id of a request's session, "" without one."""
    return str(request.session.get(SESSION, ""))


def _password_in(body: bytes) -> str:
    """The password of a form; "" when there is none, or a longer one than can be set."""
    fields = parse_qs(body.decode("utf-8", "replace"), max_num_fields=4) if body.count(b"&") < 4 else {}
    password = fields.get("password", [""])[0]
    return password if len(password) <= PASSWORD_LENGTH_MAX else ""


def _form(problem: str, status: int = 200) -> Response:
    page = (STATIC / "login.html").read_text(encoding="utf-8")
    return HTMLResponse(page.replace("{{problem}}", escape(problem)), status, headers={"Cache-Control": "no-store"})


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
