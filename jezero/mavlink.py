"""MAVLink 2 over any byte pipe: packing, parsing, and dropping what is malformed.

The one place that knows pymavlink. `HIL_SENSOR` and `HIL_GPS` have a field `id` that shadows pymavlink's message
attribute, so messages are told apart by `get_msgId()`.
"""

import hashlib
import hmac
import math
import struct
from operator import attrgetter
from typing import Any

from fastcrc import crc16
from pymavlink.dialects.v20 import common as dialect

__all__ = ["MavMessage", "MavlinkCodec", "Signing", "dialect", "is_finite"]

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


class _Layout:
    """A message of the dialect as it stands on the wire, to pack and parse it at a third of pymavlink's cost.

    Args:
        message_type: pymavlink's class; one without text.
    """

    HEADER = struct.Struct("<BBBBBBBHB")

    def __init__(self, message_type: Any) -> None:
        names, counts = message_type.ordered_fieldnames, message_type.array_lengths
        self._type = message_type
        self._unpacker = message_type.unpacker
        self._id = message_type.id
        self._names = names
        self._get = attrgetter(*names) if len(names) > 1 else lambda message: (getattr(message, names[0]),)
        self._arrays = [(place, counts[place]) for place in range(len(names)) if counts[place]]
        self._crc_extra = bytes((message_type.crc_extra,))
        blank = message_type(*([0] * count if count else 0 for count in _in_order_of_fields(message_type)))
        self._blank = {name: value for name, value in vars(blank).items() if name not in names}

    def pack(self, message: MavMessage, system_id: int, component_id: int, sequence: int) -> bytes:
        """A MAVLink 2 frame without a signature."""
        values: Any = self._get(message)
        if self._arrays:
            values = list(values)
            for place, _ in reversed(self._arrays):
                values[place : place + 1] = values[place]
        payload: bytes = self._unpacker.pack(*values)
        payload = payload.rstrip(b"\0") or payload[:1]
        size, message_id = len(payload), self._id
        header = (0xFD, size, 0, 0, sequence, system_id, component_id, message_id & 0xFFFF, message_id >> 16)
        frame = self.HEADER.pack(*header) + payload
        crc = crc16.mcrf4xx(frame[1:] + self._crc_extra)
        return frame + bytes((crc & 0xFF, crc >> 8))

    def parse(self, frame: bytes) -> MavMessage | None:
        """The message of one whole frame without a signature; None when its checksum is wrong."""
        crc = crc16.mcrf4xx(frame[1:-2] + self._crc_extra)
        if crc != frame[-2] | frame[-1] << 8:
            return None
        _, size, incompatible, compatible, sequence, system_id, component_id, _, _ = self.HEADER.unpack_from(frame)
        length = self._unpacker.size
        payload = frame[10:-2]
        values: Any = self._unpacker.unpack(payload.ljust(length, b"\0") if size < length else payload[:length])
        if self._arrays:
            values = list(values)
            for place, count in self._arrays:
                values[place : place + count] = [values[place : place + count]]
        message = self._type.__new__(self._type)
        fields = message.__dict__
        fields.update(self._blank)
        fields.update(zip(self._names, values, strict=True))
        fields["_header"] = dialect.MAVLink_header(
            self._id, incompatible, compatible, size, sequence, system_id, component_id
        )
        fields["_msgbuf"], fields["_crc"] = frame, crc
        return message


def _in_order_of_fields(message_type: Any) -> list[int]:
    """Lengths of the arrays among a message's fields, 0 for others, in the order of its constructor."""
    lengths = dict(zip(message_type.ordered_fieldnames, message_type.array_lengths, strict=True))
    return [lengths[name] for name in message_type.fieldnames]


_LAYOUTS = {key: _Layout(kind) for key, kind in dialect.mavlink_map.items() if "char" not in kind.fieldtypes}


class MavlinkCodec:
    """Packs with its own system id and sequence, and parses whatever bytes arrive.

    Args:
        system_id: MAVLink system id of this side.
        component_id: MAVLink component id of this side.
        signing: signs what is packed, and drops what it doesn't believe.
    """

    def __init__(self, system_id: int, component_id: int, signing: Signing | None = None) -> None:
        self._signing = signing
        self._packer = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        if signing is not None:
            self._packer.signing.secret_key = signing.key
            self._packer.signing.sign_outgoing = True
        self._mav = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        self._mav.robust_parsing = True
        self.malformed = 0
        """Stretches of bytes that were no message, and messages with a non-finite number where none may be."""
        self.refused = 0
        """Messages whose signature was not believed."""

    def pack(self, message: MavMessage) -> bytes:
        """Bytes of a message built by a class of `dialect`, e.g. `dialect.MAVLink_heartbeat_message(...)`."""
        packer, layout = self._packer, _LAYOUTS.get(message.get_msgId())
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
        if self._signing is None and self._mav.buf_len() == 0:
            data = data[_parse_whole(data, good) :]
        for message in (self._mav.parse_buffer(data) or []) if data else []:
            unbelieved = self._signing is not None and message.get_msgId() >= 0 and not self._signing.believes(message)
            if unbelieved:
                self.refused += 1
            elif message.get_msgId() >= 0:
                good.append(message)
            elif not isinstance(message, dialect.MAVLink_unknown):
                self.malformed += 1
        return good


def _parse_whole(data: bytes, into: list[MavMessage]) -> int:
    """Parse the frames that `data` begins with, up to the first that is not whole, correct and of a known layout.

    Returns:
        How many bytes that were.
    """
    at, end = 0, len(data)
    while end - at >= 12 and data[at] == 0xFD and data[at + 2] == 0:
        stop = at + 12 + data[at + 1]
        layout = _LAYOUTS.get(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
        if stop > end or layout is None:
            break
        message = layout.parse(bytes(data[at:stop]))
        if message is None:
            break
        into.append(message)
        at = stop
    return at


def is_finite(message: MavMessage, *fields: str) -> bool:
    """Whether the named fields hold finite numbers; MAVLink itself lets NaN and infinity pass."""
    return all(math.isfinite(getattr(message, field)) for field in fields)
