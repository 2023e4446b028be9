"""MAVLink 2 over any byte pipe: packing, parsing, and dropping what is malformed.

The one place that knows pymavlink. `HIL_SENSOR` and `HIL_GPS` have a field `id` that shadows pymavlink's message
attribute, so messages are told apart by `get_msgId()`.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as dialect

__all__ = ["Handler", "MavMessage", "MavlinkCodec", "dialect", "is_finite"]

MavMessage = Any
"""A pymavlink message object: fields as attributes, `get_msgId()`, `get_srcSystem()`, `get_srcComponent()`."""


class _Sink:
    """File-like target that pymavlink writes packed messages to; unused, as we pack without sending."""

    def write(self, data: bytes) -> int:
        return len(data)


class MavlinkCodec:
    """Packs with its own system id and sequence, and parses whatever bytes arrive.

    Args:
        system_id: MAVLink system id of this side.
        component_id: MAVLink component id of this side.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self._mav = dialect.MAVLink(_Sink(), srcSystem=system_id, srcComponent=component_id)
        self._mav.robust_parsing = True
        self.malformed = 0
        """Stretches of bytes that were no message, and messages with a non-finite number where none may be."""

    def pack(self, message: MavMessage) -> bytes:
        """Bytes of a message built by a class of `dialect`, e.g. `dialect.MAVLink_heartbeat_message(...)`."""
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
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
            if message.get_msgId() >= 0:
                good.append(message)
            elif not isinstance(message, dialect.MAVLink_unknown):
                self.malformed += 1
        return good


def is_finite(message: MavMessage, *fields: str) -> bool:
    """Whether the named fields hold finite numbers; MAVLink itself lets NaN and infinity pass."""
    return all(math.isfinite(getattr(message, field)) for field in fields)


Handler = Callable[[MavMessage], None]
