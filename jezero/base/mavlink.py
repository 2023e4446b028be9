"""MAVLink 2 over any byte pipe: packs and parses messages, signs them, and drops malformed ones.

This is the only module that uses pymavlink. `HIL_SENSOR` and `HIL_GPS` have a field `id` that shadows pymavlink's
message attribute, so the type of a message is read with `get_msgId()`.
"""

import hashlib
import hmac
import math
import struct
from collections.abc import Callable, Collection
from functools import cache, cached_property
from operator import attrgetter, itemgetter
from typing import Any

from fastcrc import crc16
from pymavlink.dialects.v20 import common as dialect

__all__ = ["FieldReader", "FramePacker", "MavMessage", "MavlinkCodec", "Signing", "dialect", "is_finite"]

MavMessage = Any
"""A pymavlink message object: fields as attributes, `get_msgId()`, `get_srcSystem()`, `get_srcComponent()`."""


class _Sink:
    """File-like object that pymavlink requires; nothing is written to it, because messages are packed, not sent."""

    def write(self, data: bytes) -> int:
        return len(data)


def _keep_nothing(_: int) -> None:
    """For a receiver that nothing can be replayed to after its end."""


class Signing:
    """MAVLink 2 signatures of one receiver. Time stamps count units of 10 µs since 2015.

    A message is accepted when its signature was made with the key, its time stamp is later than the last one of the
    same sender and link id, and the time stamp differs from the local clock by a minute at most. The checks of
    pymavlink and PX4 accept any later time stamp: a single message from the far future would lock out all others.

    A restart must not let a captured message in again, and a write for each message would take too long. So the kept
    time stamp is `AHEAD` later than the message at which it was kept: it covers all that is accepted until the next
    write. After a restart only messages above it are accepted.

    Args:
        key: the secret, 32 bytes.
        kept: the time stamp that `keep` got last before the restart; -1 when it never got one.
        keep: stores a time stamp; called before the message that needs it is accepted.

    Attributes:
        clock_10us: the local clock; the owner of this object sets it.
    """

    WINDOW = 6_000_000
    AHEAD = 500_000
    SIGNED = 0x01
    MARKER = 0xFD

    def __init__(self, key: bytes, kept: int = -1, keep: Callable[[int], None] = _keep_nothing) -> None:
        if len(key) != 32:
            raise ValueError(f"a signing key has 32 bytes, not {len(key)}")
        self.clock_10us = 0
        self._key = key
        self._at_start = self._kept = kept
        self._keep = keep
        self._last_timestamp: dict[tuple[int, int, int], int] = {}
        self._last_sent = 0

    def next_timestamp(self) -> int:
        """Time stamp for the next message to send; no two are equal."""
        self._last_sent = max(self.clock_10us, self._last_sent + 1)
        return self._last_sent

    @property
    def key(self) -> bytes:
        return self._key

    def accepts(self, message: MavMessage) -> bool:
        """Whether the message is signed with the key, recent, and not a replay."""
        data = bytes(message.get_msgbuf())
        if len(data) < 25 or data[0] != self.MARKER or not data[2] & self.SIGNED:
            return False
        signature = hashlib.sha256(self._key + data[:-6]).digest()[:6]
        if not hmac.compare_digest(signature, data[-6:]):
            return False
        stamp = int.from_bytes(data[-12:-6], "little")
        stream = (data[-13], message.get_srcSystem(), message.get_srcComponent())
        if abs(stamp - self.clock_10us) > self.WINDOW or stamp <= self._last_timestamp.get(stream, self._at_start):
            return False
        if stamp > self._kept:
            self._kept = stamp + self.AHEAD
            self._keep(self._kept)
        self._last_timestamp[stream] = stamp
        return True


UNIX_2015_S = 1_420_070_400
"""Begin of the time of signatures, in Unix time."""


LAZY_NUMBERS_MIN = 40
"""A message with more numbers than this is decoded only when one of its fields is read."""


class _Layout:
    """Wire layout of one message type; packs and parses it in less than half of the time that pymavlink takes.

    Args:
        message_type: pymavlink's class of a message without text fields.
    """

    TAIL = struct.Struct("<BBBBBBHB")
    """The header after its start marker."""

    def __init__(self, message_type: Any) -> None:
        names, counts = message_type.ordered_fieldnames, message_type.array_lengths
        self._unpacker = message_type.unpacker
        self._length = message_type.unpacker.size
        self._id = (message_type.id & 0xFFFF, message_type.id >> 16)
        self._names = names
        several = len(names) > 1
        self._get = attrgetter(*names) if several else lambda message: (getattr(message, names[0]),)
        self._arrays = [(place, counts[place]) for place in range(len(names)) if counts[place]]
        self._gather = itemgetter(*_field_indices(counts)) if several else lambda numbers: (numbers,)
        """Function from the list of all numbers to the values of the fields."""
        self._crc_extra = bytes((message_type.crc_extra,))
        self._parsed = _parsed_type(message_type, self)
        self._lazy = sum(count or 1 for count in counts) > LAZY_NUMBERS_MIN and not any(
            hasattr(self._parsed, name) for name in names
        )
        """Whether fields are decoded on first access; impossible if a field shares its name with a class attribute."""

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
        """Parse one whole frame without a signature; returns None if its checksum is wrong."""
        if crc16.mcrf4xx(frame[1:-2] + self._crc_extra) != frame[-2] | frame[-1] << 8:
            return None
        message = _new(self._parsed)
        if self._lazy:
            message._msgbuf = frame
        else:
            message.__dict__ = fields = self.read(frame)
            fields["_msgbuf"] = frame
        return message

    def read(self, frame: bytes) -> dict[str, Any]:
        """Decode all fields of a frame."""
        payload, length = frame[10:-2], self._length
        if len(payload) != length:
            payload = payload.ljust(length, b"\0")[:length]
        values: Any = self._unpacker.unpack(payload)
        if self._arrays:
            values = self._gather(list(values))
        return dict(zip(self._names, values))  # noqa: B905 - equal lengths, in a hot path


_new: Callable[[type], Any] = object.__new__


class FramePacker:
    """Packs frames of one message type directly from numbers, for messages that are sent so often that it matters.

    Args:
        kind: a class of `dialect` for a message without text fields.
        fields: names of all fields in their order on the wire. An array takes one number per element.

    Raises:
        ValueError: the names are not those of all fields in the order on the wire.
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
        if not frame[-1]:  # MAVLink 2 truncates trailing zeros
            payload = frame[10:].rstrip(b"\0") or b"\0"
            frame = b"%c%c%b%b" % (0xFD, len(payload), frame[2:10], payload)
        return frame + crc16.mcrf4xx(frame[1:] + self._crc_extra).to_bytes(2, "little")

    def message(self, numbers: tuple[Any, ...]) -> MavMessage:
        """Build a message object from the same numbers."""
        values = numbers
        if any(self.kind.array_lengths):
            values = itemgetter(*_field_indices(self.kind.array_lengths))(numbers)
        return self.kind(**dict(zip(self.kind.ordered_fieldnames, values, strict=True)))


class FieldReader:
    """Reads some numbers of one message type, for messages that arrive so often that decoding all fields is too slow.

    Args:
        kind: a class of `dialect` for a message that only MAVLink 2 has.
        fields: names in their order on the wire. An array is read as a whole, "q", or by element, "pose_covariance[6]".

    Raises:
        ValueError: there is no such field, or the names are out of order.
    """

    def __init__(self, kind: Any, *fields: str) -> None:
        remaining = list(fields)
        layout = "<"
        for name, letter, count in zip(
            kind.ordered_fieldnames, kind.native_format.decode()[1:], kind.array_lengths, strict=True
        ):
            for number in range(count or 1):
                selected = bool(remaining) and remaining[0] in (name, f"{name}[{number}]")
                layout += letter if selected else f"{struct.calcsize(f'<{letter}')}x"
                if selected and (remaining[0] != name or number + 1 == max(count, 1)):
                    del remaining[0]
        if remaining:
            raise ValueError(f"{kind.__name__} has no field {remaining[0]!r}, or not in this order")
        self._read = struct.Struct(layout)

    def __call__(self, message: MavMessage) -> tuple[Any, ...]:
        """Read the numbers from a message that `MavlinkCodec` parsed."""
        frame: bytes = message._msgbuf
        if frame[1] == self._read.size:
            return self._read.unpack_from(frame, 10)
        return self._read.unpack_from(frame[10 : 10 + frame[1]].ljust(self._read.size, b"\0"))


def _field_indices(counts: list[int]) -> list[int | slice]:
    """Index of each field in the list of all numbers of a message; a slice for an array."""
    places: list[int | slice] = []
    at = 0
    for count in counts:
        places.append(slice(at, at + count) if count else at)
        at += count or 1
    return places


def _parsed_type(message_type: Any, layout: _Layout) -> Any:
    """Subclass of pymavlink's class that stores constants in the class and decodes header and fields on access."""
    blank = message_type(*([0] * count if count else 0 for count in _array_lengths_by_field(message_type)))
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


def _array_lengths_by_field(message_type: Any) -> list[int]:
    """Array length of each field, 0 for a scalar, in the order of the constructor's arguments."""
    lengths = dict(zip(message_type.ordered_fieldnames, message_type.array_lengths, strict=True))
    return [lengths[name] for name in message_type.fieldnames]


@cache
def _layout(message_id: int) -> _Layout | None:
    """Layout of a message type; None if the dialect has no such message, or it has text fields."""
    kind = dialect.mavlink_map.get(message_id)
    return None if kind is None or "char" in kind.fieldtypes else _Layout(kind)


class MavlinkCodec:
    """Packs messages with its own system id and sequence number, and parses received bytes.

    Args:
        system_id: MAVLink system id of this side.
        component_id: MAVLink component id of this side.
        signing: signs packed messages, and drops received ones that it does not accept.
        peer: system and component id of the only sender whose messages are returned. None: all senders.
        others: components of the peer's system whose messages are returned, too.
    """

    def __init__(
        self,
        system_id: int,
        component_id: int,
        signing: Signing | None = None,
        *,
        peer: tuple[int, int] | None = None,
        others: Collection[int] = (),
    ) -> None:
        self._signing = signing
        self._peers = None if peer is None else frozenset((peer, *((peer[0], component) for component in others)))
        self._packer = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        if signing is not None:
            self._packer.signing.secret_key = signing.key
            self._packer.signing.sign_outgoing = True
        self._mav = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        self._mav.robust_parsing = True
        self._incomplete = False
        """Whether pymavlink's buffer holds the beginning of a message."""
        self.malformed = 0
        """Number of byte sequences that were no message, and of messages with invalid numbers."""
        self.other_sender: tuple[int, int] | None = None
        """System and component id of the last sender that is not the peer; None while there was none."""
        self.bad_signatures = 0
        """Number of messages without an accepted signature."""
        self.unchecked_signatures = 0
        """Number of messages with a signature that wasn't checked, as there is no `signing`."""

    def pack_numbers(self, pack: FramePacker, *numbers: Any) -> bytes:
        """Pack a message from all its numbers."""
        if self._signing is not None:
            return self.pack(pack.message(numbers))
        packer = self._packer
        sequence = packer.seq
        packer.seq = (sequence + 1) % 256
        return pack.frame(numbers, packer.srcSystem, packer.srcComponent, sequence)

    def pack(self, message: MavMessage) -> bytes:
        """Pack a message built by a class of `dialect`, e.g. `dialect.MAVLink_heartbeat_message(...)`."""
        packer, layout = self._packer, _layout(message.get_msgId())
        if self._signing is None and layout is not None:
            data = layout.pack(message, packer.srcSystem, packer.srcComponent, packer.seq)
        else:
            if self._signing is not None:
                packer.signing.timestamp = self._signing.next_timestamp()
            data = bytes(message.pack(packer))
        packer.seq = (packer.seq + 1) % 256
        return data

    def parse(self, data: bytes) -> list[MavMessage]:
        """Parse `data`, which continues the bytes of the last call; returns the complete messages.

        Malformed bytes are counted. Messages that the dialect does not have are skipped, as PX4 sends some.
        """
        if not data:
            return []
        good: list[MavMessage] = []
        if self._signing is None and not self._incomplete:
            data = data[self._parse_whole_frames(data, good) :]
        if data:
            self._parse_with_pymavlink(data, good)
        return good

    def _parse_whole_frames(self, data: bytes, into: list[MavMessage]) -> int:
        """Parse frames from the start of `data` up to the first one that is incomplete, wrong or of an unknown layout.

        Returns:
            The number of bytes parsed.
        """
        at, end, peers = 0, len(data), self._peers
        while end - at >= 12 and data[at] == 0xFD and data[at + 2] == 0:
            stop = at + 12 + data[at + 1]
            layout = _layout(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
            if stop > end or layout is None:
                break
            message = layout.parse(data[at:stop])
            if message is None:
                break
            if peers is None or (data[at + 5], data[at + 6]) in peers:
                into.append(message)
            else:
                self.other_sender = (data[at + 5], data[at + 6])
            at = stop
        return at

    def _parse_with_pymavlink(self, data: bytes, good: list[MavMessage]) -> None:
        """Parse signed and incomplete frames, and messages with text, with pymavlink."""
        peers = self._peers
        for message in self._mav.parse_buffer(data) or []:
            rejected = self._signing is not None and message.get_msgId() >= 0 and not self._signing.accepts(message)
            if rejected:
                self.bad_signatures += 1
            elif message.get_msgId() >= 0:
                if peers is None or (message.get_srcSystem(), message.get_srcComponent()) in peers:
                    good.append(message)
                    self.unchecked_signatures += self._signing is None and _is_signed(message)
                else:
                    self.other_sender = (message.get_srcSystem(), message.get_srcComponent())
            elif not isinstance(message, dialect.MAVLink_unknown):
                self.malformed += 1
        self._incomplete = self._mav.buf_len() > 0


def _is_signed(message: MavMessage) -> bool:
    frame = message.get_msgbuf()
    return len(frame) > 2 and frame[0] == Signing.MARKER and bool(frame[2] & Signing.SIGNED)


def is_finite(message: MavMessage, *fields: str) -> bool:
    """Whether the named fields hold finite numbers; MAVLink itself allows NaN and infinity."""
    for field in fields:  # noqa: SIM110 - a generator expression is slower
        if not math.isfinite(getattr(message, field)):
            return False
    return True
