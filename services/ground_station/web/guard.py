"""Guards of the pages' server: it accepts only requests of its own pages, and only small ones."""

from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import urlsplit

from fastapi import Response

BODY_MAX_BYTES = 64_000
"""Greatest size of a request's body, and of one message that a page sends."""
TOO_LARGE = f"a request has at most {BODY_MAX_BYTES} bytes"
CONTENT_SECURITY_POLICY = {
    "default-src": "'self'",
    # NiceGUI writes its start script and styles into the page; Vue compiles the components' templates in the browser.
    "script-src": "'self' 'unsafe-inline' 'unsafe-eval'",
    "style-src": "'self' 'unsafe-inline'",
    "img-src": "'self' blob: data:",
    "font-src": "'self' data:",
    "object-src": "'none'",
    "base-uri": "'none'",
    "form-action": "'self'",
    "frame-ancestors": "'none'",
}
RESPONSE_HEADERS = [
    ("Content-Security-Policy", "; ".join(f"{name} {sources}" for name, sources in CONTENT_SECURITY_POLICY.items())),
    ("X-Frame-Options", "DENY"),
    # With `no-referrer`, browsers send forms with the origin "null", which `OwnPagesOnly` refuses.
    ("Referrer-Policy", "same-origin"),
    ("X-Content-Type-Options", "nosniff"),
]
"""Headers of every response: no other site may show a page in a frame, and no page may load from another host."""

Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
Inner = Callable[[Any, Receive, Send], Awaitable[None]]


class OwnPagesOnly:
    """Refuses what another site's page sends: a browser would pass it on with the user's own address and log-in.

    A page of another site names itself in `Origin`; one that has pointed its own name at this machine in `Host`.

    Args:
        serves: whether a `Host` names this machine.
    """

    def __init__(self, inner: Inner, serves: Callable[[str], bool]) -> None:
        self._inner = inner
        self._serves = serves

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
            host, origin = headers.get(b"host", ""), headers.get(b"origin")
            if not self._serves(host) or (origin is not None and not _is_same(origin, host)):
                await refuse(scope, receive, send, 403, "only this machine's own pages are served")
                return
        await self._inner(scope, receive, send)


def _is_same(origin: str, host: str) -> bool:
    return urlsplit(origin).netloc.lower() == host.lower()


class WholeBodies:
    """Reads a request's body before the request takes a place; refuses one that is larger than any of a page.

    A client that does not send the body in time is disconnected by `Connections`.
    """

    def __init__(self, inner: Inner) -> None:
        self._inner = inner

    async def __call__(self, scope: Any, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._inner(scope, receive, send)
            return
        length = next((value for name, value in scope["headers"] if name == b"content-length"), b"0")
        if not length.isdigit() or int(length) > BODY_MAX_BYTES:
            await refuse(scope, receive, send, 413, TOO_LARGE)
            return
        body, more = b"", True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            body += message.get("body", b"")
            if len(body) > BODY_MAX_BYTES:  # a body without a length
                await refuse(scope, receive, send, 413, TOO_LARGE)
                return
            more = message.get("more_body", False)
        whole = [{"type": "http.request", "body": body, "more_body": False}]

        async def receive_whole() -> Any:
            return whole.pop() if whole else await receive()

        await self._inner(scope, receive_whole, send)


async def refuse(scope: Any, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
    else:
        await Response(f"{reason}\n", status_code=status, media_type="text/plain")(scope, receive, send)
