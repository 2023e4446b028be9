"""MAVLink 2 over any byte pipe: packing, parsing, and dropping what is malformed.

The one place that knows pymavlink. `HIL_SENSOR` and `HIL_GPS` have a field `id` that shadows pymavlink's message
attribute, so messages are told apart by `get_msgId()`.
"""

import hashlib
import hmac
import math
import struct
from collections.abc import Callable
from functools import cache, cached_property
from operator import attrgetter, itemgetter
from typing import Any

from fastcrc import crc16
from pymavlink.dialects.v20 import common as dialect

__all__ = ["MavMessage", "MavlinkCodec", "Pack", "Pick", "Signing", "dialect", "is_finite"]

MavMessage = Any
"""A pymavlink message object: fields as attributes, `get_msgId()`, `get_srcSystem()`, `get_srcComponent()`."""


class _Sink:
    """File-like target that pymavlink writes packed messages to; unused, as we pack without sending."""

    def write(self, data: bytes) -> int:
        return len(data)


class Signing:
    """MAVLink 2 signatures of one link. Time stamps count 10 µs since 2015.

    A message is believed when the key made its signature, its time stamp is later than the last of its sender on the
    same stream, and it is within a minute of this side's clock. pymavlink's own check, and PX4's, take any later time
    stamp for granted: one from the far future locks everybody out.

    Attributes:
        now: this side's clock; its owner sets it.
    """

    WINDOW = 6_000_000
    SIGNED = 0x01
    MARKER = 0xFD

    def __init__(self, key: bytes) -> None:
        if len(key) != 32:
            raise ValueError(f"a signing key has 32 bytes, not {len(key)}")
        self.now = 0
        self._key = key
        self._newest: dict[tuple[int, int, int], int] = {}
        self._sent = 0

    def stamp(self) -> int:
        """For the next message: never the same twice."""
        self._sent = max(self.now, self._sent + 1)
        return self._sent

    @property
    def key(self) -> bytes:
        return self._key

    def believes(self, message: MavMessage) -> bool:
        """Whether the message is genuine, and new."""
        data = bytes(message.get_msgbuf())
        if len(data) < 25 or data[0] != self.MARKER or not data[2] & self.SIGNED:
            return False
        signature = hashlib.sha256(self._key + data[:-6]).digest()[:6]
        if not hmac.compare_digest(signature, data[-6:]):
            return False
        stamp = int.from_bytes(data[-12:-6], "little")
        stream = (data[-13], message.get_srcSystem(), message.get_srcComponent())
        if abs(stamp - self.now) > self.WINDOW or stamp <= self._newest.get(stream, -1):
            return False
        self._newest[stream] = stamp
        return True


MANY = 40
"""A message of more numbers isn't read before it is asked for one of them."""


class _Layout:
    """A message of the dialect as it stands on the wire, to pack and parse it at less than half of pymavlink's cost.

    Args:
        message_type: pymavlink's class; one without text.
    """

    TAIL = struct.Struct("<BBBBBBHB")
    """What of the header follows its marker."""

    def __init__(self, message_type: Any) -> None:
        names, counts = message_type.ordered_fieldnames, message_type.array_lengths
        self._unpacker = message_type.unpacker
        self._length = message_type.unpacker.size
        self._id = (message_type.id & 0xFFFF, message_type.id >> 16)
        self._names = names
        several = len(names) > 1
        self._get = attrgetter(*names) if several else lambda message: (getattr(message, names[0]),)
        self._arrays = [(place, counts[place]) for place in range(len(names)) if counts[place]]
        self._gather = itemgetter(*_places(counts)) if several else lambda numbers: (numbers,)
        """From a list of all numbers, the fields' values."""
        self._crc_extra = bytes((message_type.crc_extra,))
        self._parsed = _parsed_type(message_type, self)
        self._later = sum(count or 1 for count in counts) > MANY and not any(
            hasattr(self._parsed, name) for name in names
        )
        """Fields are read when they are asked for; not where one is called like something else that messages have."""

    def pack(self, message: MavMessage, system_id: int, component_id: int, sequence: int) -> bytes:
        """A MAVLink 2 frame without a signature."""
        values: Any = self._get(message)
        if self._arrays:
            values = list(values)
            for place, _ in reversed(self._arrays):
                values[place : place + 1] = values[place]
        payload: bytes = self._unpacker.pack(*values)
        payload = payload.rstrip(b"\0") or payload[:1]
        body = self.TAIL.pack(len(payload), 0, 0, sequence, system_id, component_id, *self._id) + payload
        return b"\xfd" + body + crc16.mcrf4xx(body + self._crc_extra).to_bytes(2, "little")

    def parse(self, frame: bytes) -> MavMessage | None:
        """The message of one whole frame without a signature; None when its checksum is wrong."""
        if crc16.mcrf4xx(frame[1:-2] + self._crc_extra) != frame[-2] | frame[-1] << 8:
            return None
        message = _new(self._parsed)
        if self._later:
            message._msgbuf = frame
        else:
            message.__dict__ = fields = self.read(frame)
            fields["_msgbuf"] = frame
        return message

    def read(self, frame: bytes) -> dict[str, Any]:
        """All fields of a frame."""
        payload, length = frame[10:-2], self._length
        if len(payload) != length:
            payload = payload.ljust(length, b"\0")[:length]
        values: Any = self._unpacker.unpack(payload)
        if self._arrays:
            values = self._gather(list(values))
        return dict(zip(self._names, values))  # noqa: B905 - as many, and this is the hot path


_new: Callable[[type], Any] = object.__new__


class Pack:
    """Makes frames of messages of one kind from their numbers, where to make messages of these would cost too much.

    Args:
        kind: a class of `dialect`, without text.
        fields: all of them, in their order on the wire; of an array all numbers follow each other.

    Raises:
        ValueError: these are not the fields, or out of order.
    """

    def __init__(self, kind: Any, *fields: str) -> None:
        if list(fields) != kind.ordered_fieldnames or "char" in kind.fieldtypes:
            raise ValueError(f"the fields of {kind.__name__} are {', '.join(kind.ordered_fieldnames)}")
        self.kind = kind
        self._header_and_payload = struct.Struct("<BBBBBBBHB" + kind.unpacker.format[1:]).pack
        self._length = kind.unpacker.size
        self._id_low, self._id_high = kind.id & 0xFFFF, kind.id >> 16
        self._crc_extra = bytes((kind.crc_extra,))

    def frame(self, numbers: tuple[Any, ...], system_id: int, component_id: int, sequence: int) -> bytes:
        """A MAVLink 2 frame without a signature."""
        sender = (sequence, system_id, component_id)
        frame = self._header_and_payload(0xFD, self._length, 0, 0, *sender, self._id_low, self._id_high, *numbers)
        if not frame[-1]:  # zeros at the end are not sent
            payload = frame[10:].rstrip(b"\0") or b"\0"
            frame = b"%c%c%b%b" % (0xFD, len(payload), frame[2:10], payload)
        return frame + crc16.mcrf4xx(frame[1:] + self._crc_extra).to_bytes(2, "little")

    def message(self, numbers: tuple[Any, ...]) -> MavMessage:
        """The same as a message."""
        values = numbers
        if any(self.kind.array_lengths):
            values = itemgetter(*_places(self.kind.array_lengths))(numbers)
        return self.kind(**dict(zip(self.kind.ordered_fieldnames, values, strict=True)))


class Pick:
    """Reads some numbers of a message of one kind, where all of them would cost too much.

    Args:
        kind: a class of `dialect`, one that only MAVLink 2 has.
        fields: in their order on the wire; of an array all numbers, or one: "q", "pose_covariance[6]".

    Raises:
        ValueError: there is no such field, or it is out of order.
    """

    def __init__(self, kind: Any, *fields: str) -> None:
        wanted = list(fields)
        layout = "<"
        for name, letter, count in zip(
            kind.ordered_fieldnames, kind.native_format.decode()[1:], kind.array_lengths, strict=True
        ):
            for number in range(count or 1):
                here = bool(wanted) and wanted[0] in (name, f"{name}[{number}]")
                layout += letter if here else f"{struct.calcsize(f'<{letter}')}x"
                if here and (wanted[0] != name or number + 1 == max(count, 1)):
                    del wanted[0]
        if wanted:
            raise ValueError(f"{kind.__name__} has no field {wanted[0]!r}, or not in this order")
        self._read = struct.Struct(layout)

    def __call__(self, message: MavMessage) -> tuple[Any, ...]:
        """The numbers, of a message that `MavlinkCodec` parsed."""
        frame: bytes = message._msgbuf
        if frame[1] == self._read.size:
            return self._read.unpack_from(frame, 10)
        return self._read.unpack_from(frame[10 : 10 + frame[1]].ljust(self._read.size, b"\0"))


def _places(counts: list[int]) -> list[int | slice]:
    """Of the fields among all numbers of a message: an index, or a slice for an array."""
    places: list[int | slice] = []
    at = 0
    for count in counts:
        places.append(slice(at, at + count) if count else at)
        at += count or 1
    return places


def _parsed_type(message_type: Any, layout: _Layout) -> Any:
    """pymavlink's class with all that isn't a message's own in the class, and what is read off the frame when it is
    asked for: the header, and all fields."""
    blank = message_type(*([0] * count if count else 0 for count in _in_order_of_fields(message_type)))
    constant = {name: value for name, value in vars(blank).items() if name not in message_type.fieldnames}
    message_id: int = message_type.id

    names = frozenset(message_type.fieldnames)

    class Parsed(message_type):  # type: ignore[misc]
        def __getattr__(self, name: str) -> Any:
            if name not in names:
                raise AttributeError(f"{message_type.__name__} has no {name!r}")
            self.__dict__ = layout.read(self._msgbuf) | self.__dict__
            return self.__dict__[name]

        def get_msgId(self) -> int:  # noqa: N802
            return message_id

        def get_srcSystem(self) -> int:  # noqa: N802
            system_id: int = self._msgbuf[5]
            return system_id

        def get_srcComponent(self) -> int:  # noqa: N802
            component_id: int = self._msgbuf[6]
            return component_id

        @cached_property
        def _header(self) -> Any:
            frame = self._msgbuf
            return dialect.MAVLink_header(message_id, frame[2], frame[3], frame[1], *frame[4:7])

        @cached_property
        def _crc(self) -> int:
            return int.from_bytes(self._msgbuf[-2:], "little")

    for name, value in constant.items():
        if name not in ("_header", "_crc", "_msgbuf"):
            setattr(Parsed, name, value)
    return Parsed


def _in_order_of_fields(message_type: Any) -> list[int]:
    """Lengths of the arrays among a message's fields, 0 for others, in the order of its constructor."""
    lengths = dict(zip(message_type.ordered_fieldnames, message_type.array_lengths, strict=True))
    return [lengths[name] for name in message_type.fieldnames]


@cache
def _layout(message_id: int) -> _Layout | None:
    """None for what the dialect hasn't got, and for messages with text."""
    kind = dialect.mavlink_map.get(message_id)
    return None if kind is None or "char" in kind.fieldtypes else _Layout(kind)


class MavlinkCodec:
    """Packs with its own system id and sequence, and parses whatever bytes arrive.

    Args:
        system_id: MAVLink system id of this side.
        component_id: MAVLink component id of this side.
        signing: signs what is packed, and drops what it doesn't believe.
        hears: system and component whose messages count; others' are dropped. None: everybody's count.
    """

    def __init__(
        self,
        system_id: int,
        component_id: int,
        signing: Signing | None = None,
        *,
        hears: tuple[int, int] | None = None,
    ) -> None:
        self._signing = signing
        self._hears = hears
        self._packer = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        if signing is not None:
            self._packer.signing.secret_key = signing.key
            self._packer.signing.sign_outgoing = True
        self._mav = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        self._mav.robust_parsing = True
        self._rest = False
        """There are bytes left over."""
        self.malformed = 0
        """Stretches of bytes that were no message, and messages with a non-finite number where none may be."""
        self.refused = 0
        """Messages whose signature was not believed."""

    def pack_numbers(self, pack: Pack, *numbers: Any) -> bytes:
        """Bytes of a message from all its numbers, for what is sent often."""
        if self._signing is not None:
            return self.pack(pack.message(numbers))
        packer = self._packer
        sequence = packer.seq
        packer.seq = (sequence + 1) % 256
        return pack.frame(numbers, packer.srcSystem, packer.srcComponent, sequence)

    def pack(self, message: MavMessage) -> bytes:
        """Bytes of a message built by a class of `dialect`, e.g. `dialect.MAVLink_heartbeat_message(...)`."""
        packer, layout = self._packer, _layout(message.get_msgId())
        if self._signing is None and layout is not None:
            data = layout.pack(message, packer.srcSystem, packer.srcComponent, packer.seq)
        else:
            if self._signing is not None:
                packer.signing.timestamp = self._signing.stamp()
            data = bytes(message.pack(packer))
        packer.seq = (packer.seq + 1) % 256
        return data

    def parse(self, data: bytes) -> list[MavMessage]:
        """Complete messages in `data` and what was left over from before.

        Malformed bytes are counted; messages that the dialect doesn't have, of which PX4 sends some, are skipped.
        """
        if not data:
            return []
        good: list[MavMessage] = []
        if self._signing is None and not self._rest:
            data = data[_parse_whole(data, good, self._hears) :]
        if data:
            self._parse_rest(data, good)
        return good

    def _parse_rest(self, data: bytes, good: list[MavMessage]) -> None:
        """By pymavlink."""
        hears = self._hears
        for message in self._mav.parse_buffer(data) or []:
            unbelieved = self._signing is not None and message.get_msgId() >= 0 and not self._signing.believes(message)
            if unbelieved:
                self.refused += 1
            elif message.get_msgId() >= 0:
                if hears is None or hears == (message.get_srcSystem(), message.get_srcComponent()):
                    good.append(message)
            elif not isinstance(message, dialect.MAVLink_unknown):
                self.malformed += 1
        self._rest = self._mav.buf_len() > 0


def _parse_whole(data: bytes, into: list[MavMessage], hears: tuple[int, int] | None) -> int:
    """Parse the frames that `data` begins with, up to the first that is not whole, correct and of a known layout.

    Returns:
        How many bytes that were.
    """
    at, end = 0, len(data)
    while end - at >= 12 and data[at] == 0xFD and data[at + 2] == 0:
        stop = at + 12 + data[at + 1]
        layout = _layout(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
        if stop > end or layout is None:
            break
        message = layout.parse(data[at:stop])
        if message is None:
            break
        if hears is None or hears == (data[at + 5], data[at + 6]):
            into.append(message)
        at = stop
    return at


def is_finite(message: MavMessage, *fields: str) -> bool:
    """Whether the named fields hold finite numbers; MAVLink itself lets NaN and infinity pass."""
    for field in fields:  # noqa: SIM110 - a generator costs more than what it yields
        if not math.isfinite(getattr(message, field)):
            return False
    return True
