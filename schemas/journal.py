"""The journal of a service: all that decided what the service did, and what it did, so that it can be replayed."""

from typing import Annotated, Any

import msgspec
from msgspec import Meta, Raw

from jezero.schemas.struct import Message, Name


class JournalEntry(msgspec.Struct, frozen=True, array_like=True):
    """Base of the entries. In JSON an entry is an array; its kind comes first, then its fields in their order."""


class Step(JournalEntry, frozen=True, array_like=True, tag="step"):
    """The service was stepped. Its inputs stand before this entry, its outputs after it.

    Attributes:
        t_ns: vehicle time.
        wall_ns: monotonic wall time in ns.
        connected: whether the bus's router was reachable.
        stalled_ns: stalls of the process so far, which are left out of `wall_ns`.
    """

    t_ns: int
    wall_ns: int
    connected: bool
    stalled_ns: int = 0


# -- inputs of the next step -------------------------------------------------------------------------------


class Received(JournalEntry, frozen=True, array_like=True, tag="received"):
    """A message of a topic.

    Attributes:
        topic: name of the topic.
        message: the message, without its attachment.
        crc32: checksum of its attachment; None for a message without one.
    """

    topic: str
    message: Raw
    crc32: int | None = None


class Requested(JournalEntry, frozen=True, array_like=True, tag="requested"):
    """A request of a client.

    Attributes:
        endpoint: name of the endpoint.
        request_id: names the request in each reply.
        client_id: the sender's; "" when it didn't name itself.
        request: its fields as JSON; null for a request without a payload.
        parameters: fields that came as parameters of the key.
    """

    endpoint: str
    request_id: int
    client_id: str
    request: Raw
    parameters: dict[str, str] = {}


class Refused(JournalEntry, frozen=True, array_like=True, tag="refused"):
    """A request that was no valid one; the service never saw it.

    Attributes:
        endpoint: name of the endpoint.
        client_id: the sender's; "" when it didn't name itself.
        request: what arrived, as text.
        reason: why it was refused.
    """

    endpoint: str
    client_id: str
    request: str
    reason: str


class Answered(JournalEntry, frozen=True, array_like=True, tag="answered"):
    """A reply to one of the service's own requests, or its end without one.

    Attributes:
        call_id: that of the call.
        reply: the reply; null after an error.
        error: reason why there is no reply, or no more, or None.
    """

    call_id: str
    reply: Raw
    error: str | None = None


class TaskEnded(JournalEntry, frozen=True, array_like=True, tag="task ended"):
    """A background task of the service ended. Its value is not kept: a replay computes it again.

    Attributes:
        task: that of the task.
        error: reason why there is no value, or None.
    """

    task: str
    error: str | None = None


class LinkBytes(JournalEntry, frozen=True, array_like=True, tag="link bytes"):
    """Bytes from a link (in JSON: base64)."""

    link: str
    data: bytes


class LinkState(JournalEntry, frozen=True, array_like=True, tag="link state"):
    """A link was connected or lost."""

    link: str
    up: bool


class Departed(JournalEntry, frozen=True, array_like=True, tag="departed"):
    """A client or a service vanished.

    Attributes:
        name: id of the client, or name of the service.
    """

    name: str


# -- outputs -----------------------------------------------------------------------------------------------


class Published(JournalEntry, frozen=True, array_like=True, tag="published"):
    """A message of the service on one of its topics; see `Received`."""

    topic: str
    message: Raw
    crc32: int | None = None


class Replied(JournalEntry, frozen=True, array_like=True, tag="replied"):
    """A reply of the service.

    Attributes:
        request_id: the request's.
        reply: the reply, without its attachment; null for none.
        final: whether it ended the request.
        crc32: checksum of its attachment; None for a reply without one.
    """

    request_id: int
    reply: Raw
    final: bool
    crc32: int | None = None


class Called(JournalEntry, frozen=True, array_like=True, tag="called"):
    """A request of the service to another one."""

    endpoint: str
    call_id: str
    request: Raw


class Sent(JournalEntry, frozen=True, array_like=True, tag="sent"):
    """Bytes for a link (in JSON: base64)."""

    link: str
    data: bytes


class Changed(JournalEntry, frozen=True, array_like=True, tag="changed"):
    """A change of the service's subscriptions, rate or background tasks: which one, and its new value."""

    what: str
    value: str


Input = Received | Requested | Refused | Answered | TaskEnded | LinkBytes | LinkState | Departed
Output = Published | Replied | Called | Sent | Changed
AnyEntry = Step | Input | Output


class JournalPart(Message, frozen=True, kw_only=True):
    """A part of a service's journal. A recording that has all parts from number 0 on can replay the service.

    Attributes:
        service: name of the service.
        boot_id: id of this run of the service.
        number: of the part, from 0.
        made_with: arguments of the service's constructor, in part 0 only; among them are all its settings.
        made_by: class of the service as `module:class`, in part 0 only.
        entries: what happened, in its order.
    """

    service: Name
    boot_id: int
    number: Annotated[int, Meta(ge=0)]
    made_with: dict[str, Any] = {}
    made_by: str = ""
    entries: tuple[AnyEntry, ...] = ()
