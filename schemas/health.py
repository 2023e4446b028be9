"""Health of a service."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import Message, Name, NonNegative, Payload, Text

ServiceState = Literal["starting", "ok", "degraded"]
"""`starting` is not usable yet, `ok` works, `degraded` works, but something is missing or late."""


class InputHealth(Payload, frozen=True, kw_only=True):
    """State of one input of a service.

    Attributes:
        received: number of messages since the start.
        rejected: number of these messages that were undecodable, out of range or misdirected; the service ignores them.
        dropped: number of single readings, such as one UWB range of four, that were left out of valid messages.
        age_s: wall time since the last valid message. None before the first one.
    """

    received: int = 0
    rejected: int = 0
    dropped: int = 0
    age_s: NonNegative | None = None


class ServiceHealth(Message, frozen=True, kw_only=True):
    """State of a service, published by its runtime at 1 Hz of wall time and when the state changes.

    Attributes:
        service: name of the service.
        boot_id: id of this run of the service; every run has another one.
        process: host and process id, for people.
        state: `starting` is not usable yet, `ok` works, `degraded` works, but something is missing or late.
        text: description of the state, for people.
        inputs: state of each input by the topic's name.
        not_sent: number of messages that were dropped because a value was not finite.
        failed_steps: number of steps that an error in the service's own code ended early.
        last_error: reason why the last rejected or dropped message was invalid, or the last step failed; "" without
            one.
        room_bytes: free space for what the service writes. None for a service that does not write.
        late_s: greatest delay of a step's start in the last second.
    """

    service: Name
    boot_id: int
    process: Text = ""
    state: ServiceState
    text: Text
    inputs: dict[str, InputHealth] = {}
    not_sent: Annotated[int, Meta(ge=0)] = 0
    failed_steps: Annotated[int, Meta(ge=0)] = 0
    last_error: Text = ""
    room_bytes: Annotated[int, Meta(ge=0)] | None = None
    late_s: NonNegative = 0.0


class GateLinks(Message, frozen=True, kw_only=True):
    """The links of the gate of one computer, published by it at 1 Hz of wall time, and its reply to a request.

    Attributes:
        gate: Zenoh's id of its session, 1 to 32 hexadecimal digits.
        process: host and process id.
        linked: ids of the gates of other computers with which it has a link.
    """

    gate: Name
    process: Text = ""
    linked: tuple[Name, ...] = ()
