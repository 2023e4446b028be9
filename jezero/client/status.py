"""The vehicle's status: the last one, each change, the wait until it is ready, and the preflight checks."""

import time
from collections.abc import Iterator

from jezero.client.errors import Refused, TimedOut, Unreachable
from jezero.client.session import Connection, decode
from jezero.schemas.preflight import GetPreflight, PreflightReply, PreflightReport
from jezero.schemas.state import STATUS_WORDS, Status, StatusCode
from jezero.schemas.topics import CHECK_PREFLIGHT, STATUS

REPLY_TIMEOUT_S = 3.0
STATUS_TIMEOUT_S = 3.0
"""The bridge publishes its status ten times a second."""
PREFLIGHT_TIMEOUT_S = 10.0
"""A round of checks takes at most four seconds, and the one in work ends before."""


def request_status(connection: Connection) -> Status:
    """The last status.

    Raises:
        Unreachable: no vehicle bridge replies.
        TimedOut: the reply is missing.
    """
    arrivals = connection.stream(STATUS.name, b"", REPLY_TIMEOUT_S)
    status: Status = decode(Status, connection.first(arrivals, STATUS.name, REPLY_TIMEOUT_S))
    connection.set_vehicle_time(status.t_ns)
    return status


def check_preflight(connection: Connection) -> PreflightReport:
    """Check everything before a takeoff, which takes a second and a half; see `Vehicle.preflight`."""
    reply: PreflightReply = connection.request(CHECK_PREFLIGHT, GetPreflight(), PREFLIGHT_TIMEOUT_S)
    if reply.report is None:
        raise Refused(reply.reason)
    return reply.report


def watch_status(connection: Connection) -> Iterator[Status]:
    """Yield the last status, then every changed one.

    Raises:
        Unreachable: no status came for STATUS_TIMEOUT_S.
        TimedOut: the reply to the first request is missing.
    """
    arrivals, undeclare = connection.subscribe(STATUS)
    try:
        status = request_status(connection)
        yield status
        while True:
            try:
                data = arrivals.take(time.monotonic() + STATUS_TIMEOUT_S)
            except TimedOut:
                data = None
            if data is None:
                raise Unreachable(no_status(connection))
            newer: Status = decode(Status, data)
            if newer != status:
                status = newer
                yield status
    finally:
        undeclare()


def no_status(connection: Connection) -> str:
    """Error text for a vehicle that publishes no status any more."""
    known = connection.loss_reason() or connection.hidden_reason()
    return known or f"no status of {connection.vehicle} for {STATUS_TIMEOUT_S:g} s"


def wait_ready(connection: Connection, timeout_s: float) -> Status:
    """Wait until the vehicle is ready for a takeoff or flies already.

    Raises:
        TimedOut: it is not ready in time; the text is the reason.
        Unreachable: the connection was closed.
    """
    deadline_s = time.monotonic() + timeout_s
    reason = "no status is published"
    while True:
        try:
            for status in watch_status(connection):
                if status.ready:
                    return status
                reason = status.not_ready_reason or f"it {STATUS_WORDS[StatusCode(status.code)]}"
                if time.monotonic() > deadline_s:
                    break
        except (Unreachable, TimedOut) as error:
            if connection.closed:
                raise
            reason = str(error)
            time.sleep(min(0.1, max(deadline_s - time.monotonic(), 0.0)))
        if time.monotonic() > deadline_s:
            raise TimedOut(f"{connection.vehicle} is not ready after {timeout_s:g} s: {reason}")
