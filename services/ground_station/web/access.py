"""Logging in and out. Whoever has not logged in only watches, where the pages can be reached from other machines."""

import asyncio
import time
from html import escape
from typing import Any
from urllib.parse import parse_qs

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from jezero.services.ground_station.config import GroundStationConfig
from jezero.services.ground_station.listening import Listening
from jezero.services.ground_station.password import LENGTH_MAX, matches
from jezero.services.ground_station.sessions import LoginLimiter, Sessions
from jezero.services.ground_station.web.elements import STATIC

COOKIE = "jezero_session"
CHECKS_MAX = 4
"""Passwords that are checked or wait for it; each check takes 32 MiB, so that there is one at a time."""
WATCHING = "you are watching: log in to fly"


class Access:
    """The log-ins of one server."""

    def __init__(self, config: GroundStationConfig, listening: Listening) -> None:
        self._listening = listening
        self._config = config
        self._sessions = Sessions(config.session_idle_s, config.session_max_s)
        self._limiter = LoginLimiter()
        self._checking = asyncio.Lock()
        self._checks = 0

    @property
    def needs_login(self) -> bool:
        """Whether only those who have logged in may fly."""
        return bool(self._listening.password_hash)

    def remaining_s(self, token: str) -> float:
        """Time until a page may not fly any more; 0 for one that only watches."""
        return self._sessions.remaining_s(token, time.monotonic()) if self.needs_login else float("inf")

    def use(self, token: str) -> bool:
        """Note that somebody uses a page; returns whether it may fly."""
        return not self.needs_login or self._sessions.use(token, time.monotonic())

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
        reply = RedirectResponse("/", 303)
        reply.set_cookie(
            COOKIE,
            self._sessions.begin(time.monotonic()),
            max_age=int(self._config.session_max_s),
            httponly=True,
            samesite="strict",
            secure=bool(self._listening.certificate),
        )
        return reply

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
        self._sessions.end(token_of(request))
        reply = RedirectResponse("/", 303)
        reply.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=bool(self._listening.certificate))
        return reply


def token_of(request: Any) -> str:
    """The token of a request's session, "" without one."""
    return str(request.cookies.get(COOKIE, ""))


def _password_in(body: bytes) -> str:
    """The password of a form; "" when there is none, or a longer one than can be set."""
    fields = parse_qs(body.decode("utf-8", "replace"), max_num_fields=4) if body.count(b"&") < 4 else {}
    password = fields.get("password", [""])[0]
    return password if len(password) <= LENGTH_MAX else ""


def _form(problem: str, status: int = 200) -> Response:
    page = (STATIC / "login.html").read_text(encoding="utf-8")
    return HTMLResponse(page.replace("{{problem}}", escape(problem)), status, headers={"Cache-Control": "no-store"})
