"""MAVLink 2 over any byte pipe: packing, parsing, and dropping what is malformed.

The one place that knows pymavlink. `HIL_SENSOR` and `HIL_GPS` have a field `id` that shadows pymavlink's message
attribute, so messages are told apart by `get_msgId()`.
"""

import hashlib
import hmac
import math
from typing import Any

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
        packer = self._packer
        if self._signing is not None:
            packer.signing.timestamp = self._signing.stamp()
        data = message.pack(packer)
        packer.seq = (packer.seq + 1) % 256
        return bytes(data)

    def parse(self, data: bytes) -> list[MavMessage]:
        """Complete messages in `data` and what was left over from before.

        Malformed bytes are counted; messages that the dialect doesn't have, of which PX4 sends some, are skipped.
        """
        if not data:
            return []
        parsed = self._mav.parse_buffer(data) or []
        good = []
        for message in parsed:
            unbelieved = self._signing is not None and message.get_msgId() >= 0 and not self._signing.believes(message)
            if unbelieved:
                self.refused += 1
            elif message.get_msgId() >= 0:
                good.append(message)
            elif not isinstance(message, dialect.MAVLink_unknown):
                self.malformed += 1
        return good


def is_finite(message: MavMessage, *fields: str) -> bool:
    """Whether the named fields hold finite numbers; MAVLink itself lets NaN and infinity pass."""
    return all(math.isfinite(getattr(message, field)) for field in fields)
