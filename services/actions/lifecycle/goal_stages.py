"""The stages of a goal before it flies, and the bridge's replies in them."""

from dataclasses import dataclass
from typing import ClassVar

from jezero.runtime.service import Inbox, Response
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.lifecycle.goal_flight import GoalFlight

ACQUIRE_TIMEOUT_S = 1.0
"""Time-out of the bridge's reply; the bridge refuses older requests."""
NO_REPLY = "the vehicle bridge did not reply"


@dataclass(frozen=True)
class New:
    """The goal has just arrived."""

    name: ClassVar = "new"


@dataclass(frozen=True)
class Admitting:
    """The goal has asked the bridge whether it would get control, before anything else can refuse it."""

    name: ClassVar = "admitting"
    deadline_ns: int
    tag: str


@dataclass(frozen=True)
class Checking:
    """The goal waits for its inputs, which are checked then."""

    name: ClassVar = "checking"
    deadline_ns: int


@dataclass(frozen=True)
class Acquiring:
    """The goal has requested control from the bridge."""

    name: ClassVar = "acquiring"
    deadline_ns: int
    tag: str
    flight: GoalFlight


@dataclass(frozen=True)
class Over:
    """The goal was rejected, or planned."""

    name: ClassVar = "over"


def reply_deadline_ns(t_ns: int) -> int:
    """Time at which a reply of the bridge is missing, somewhat after the call's own time-out."""
    return t_ns + int((ACQUIRE_TIMEOUT_S + 0.5) * NS_PER_S)


def refusal_by(response: Response | None, t_ns: int, deadline_ns: int) -> str:
    """Reason why the bridge refuses, or doesn't reply; "" while the reply may come, and for a grant."""
    if response is None:
        return NO_REPLY if t_ns > deadline_ns else ""
    if response.payload is None:
        return f"{NO_REPLY}: {response.error}"
    return "" if response.payload.granted else str(response.payload.reason)


def response_to(inbox: Inbox, tag: str) -> Response | None:
    """Response to the call with a tag; None while there is none."""
    return next((response for response in inbox.responses if response.tag == tag), None)
