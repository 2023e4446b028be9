"""A member of the team that sends without end: `python -m benchmarks.speed.flooder KIND VEHICLE ENDPOINT SECONDS`.

ENDPOINT is Zenoh's endpoint of a gate, with the files of the member's bundle. KIND is one of `FLOODS`. Whenever its
link is closed it connects again. It prints the number of messages that it has sent.
"""

import sys
import time
from collections.abc import Callable
from contextlib import suppress

import zenoh

from jezero.base.zenoh_client import client_config
from jezero.schemas.topics import STATUS, key, liveliness_key

SESSIONS = 4
MESSAGES = 50
CONNECT_TIMEOUT_S = 2.0
QUESTIONS_HZ, TOKENS_HZ = 2000.0, 770.0
"""Rates of one session at which an earlier router stalled its own computer."""


def put(session: zenoh.Session, vehicle: str, number: int) -> None:
    """Publish where only services may."""
    session.put(key(vehicle, f"{STATUS.name}/{number % 997}"), b"{}", congestion_control=zenoh.CongestionControl.BLOCK)


def ask(session: zenoh.Session, vehicle: str, number: int) -> None:
    """Send a request that everybody may send."""
    session.get(key(vehicle, f"{STATUS.name}/{number % 997}"), lambda _reply: None, timeout=1.0)
    time.sleep(1.0 / QUESTIONS_HZ)


def declare(session: zenoh.Session, vehicle: str, number: int) -> None:
    """Declare and undeclare a liveliness token and a subscriber."""
    token = session.liveliness().declare_token(liveliness_key(vehicle, "client", f"x{number % 997}"))
    subscriber = session.declare_subscriber(key(vehicle, f"x/{number % 997}"), lambda _sample: None)
    time.sleep(1.0 / TOKENS_HZ)
    for declared in (token, subscriber):
        declared.undeclare()  # type: ignore[no-untyped-call]


FLOODS: dict[str, Callable[[zenoh.Session, str, int], None]] = {"put": put, "ask": ask, "declare": declare}


def connected(session: zenoh.Session | None, endpoint: str) -> zenoh.Session:
    """The session, or a new one where its link was closed.

    Raises:
        zenoh.ZError: no link comes about.
    """
    if session is not None and list(session.info.routers_zid()):
        return session
    if session is not None:
        session.close()  # type: ignore[no-untyped-call]
    return zenoh.open(client_config(endpoint, CONNECT_TIMEOUT_S))


def main() -> None:
    """Flood with several sessions at a time."""
    kind, vehicle, endpoint, seconds = sys.argv[1:]
    deadline_s = time.monotonic() + float(seconds)
    sessions: list[zenoh.Session | None] = [None] * SESSIONS
    sent = 0
    while time.monotonic() < deadline_s:
        for place in range(SESSIONS):
            with suppress(zenoh.ZError):
                session = sessions[place] = connected(sessions[place], endpoint)
                for _ in range(MESSAGES):
                    FLOODS[kind](session, vehicle, sent)
                    sent += 1
    print(sent)


if __name__ == "__main__":
    main()
