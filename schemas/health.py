"""How well a service is doing."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import Message, Name, NonNegative, Payload, Text

ServiceState = Literal["starting", "ok", "degraded"]
"""starting: not usable yet. ok: working. degraded: working, but something it needs is missing or late."""


class InputHealth(Payload, frozen=True, kw_only=True):
    """One input of a service.

    Attributes:
        received: messages since start.
        rejected: of these, undecodable, out of range or misdirected ones; never acted on.
        age_s: wall time since the last good one; None while there was none.
    """

    received: int = 0
    rejected: int = 0
    age_s: NonNegative | None = None


class ServiceHealth(Message, frozen=True, kw_only=True):
    """Published at 1 Hz of wall time by every service's runtime.

    Attributes:
        boot_id: differs between two runs of the same service.
        process: host and process id that run it, for people.
        text: a sentence for people.
        not_sent: outputs that were dropped because they were not finite.
        last_error: why the last message was rejected or not sent.
        late_s: by how much the worst step of the last second started late.
    """

    service: Name
    boot_id: int
    process: Text = ""
    state: ServiceState
    text: Text
    inputs: dict[str, InputHealth] = {}
    not_sent: Annotated[int, Meta(ge=0)] = 0
    last_error: Text = ""
    late_s: NonNegative = 0.0
