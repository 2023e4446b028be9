"""Parameters of a flight controller, read and set one after the other over MAVLink, while no stack flies."""

from collections.abc import Iterable

from jezero.base.config import Config
from jezero.base.mavlink import MavlinkCodec, Signing, dialect
from jezero.services.vehicle_bridge.autopilot_link import autopilot_refusal
from jezero.services.vehicle_bridge.config import ParameterName, ParameterValue
from jezero.services.vehicle_bridge.parameters import TRIES, Value, decoded, encoded

COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
CONTROLLER_ID = dialect.MAV_COMP_ID_AUTOPILOT1
RETRY_PERIOD_NS = 300_000_000
HEARTBEAT_PERIOD_NS = 500_000_000
AT_ONCE = 8
"""Requests that may wait for their replies at the same time: a slow line has a small buffer."""


class Parameter(Config, frozen=True, kw_only=True):
    """One parameter that a flight controller needs.

    Attributes:
        name: PX4's name.
        value: 1 is an integer, 1.0 a float.
        why: what it is for, in the question before it is set.
    """

    name: ParameterName
    value: ParameterValue
    why: str = ""


class ParameterFile(Config, frozen=True, kw_only=True):
    """Parameters that jezero needs of a real flight controller.

    Attributes:
        parameter: one table for each.
    """

    parameter: list[Parameter]


class ParameterExchange:
    """Asks for parameters, sets them, and collects what the controller replies.

    Args:
        system_id: the controller's MAVLink system id; 0 for that of the first one that sends a HEARTBEAT.
        key: of the link's signatures, 32 bytes; b"" for a link without signatures.
        since_2015_s: wall time at the start, for the time stamps of signatures.

    Attributes:
        system_id: the controller's; 0 while it isn't known.
        values: parameters that the controller has reported, by name.
        unknown: names that it didn't reply to.
        refusal: why this controller's parameters are left alone, as it has others than PX4, or "".
    """

    def __init__(self, system_id: int = 0, key: bytes = b"", since_2015_s: float = 0.0) -> None:
        self.system_id = system_id
        self.values: dict[str, Value] = {}
        self.unknown: list[str] = []
        self.refusal = ""
        self._since_2015_10us = int(since_2015_s * 1e5)
        self._signing = Signing(key, self._since_2015_10us) if key else None
        self._codec = MavlinkCodec(255, COMPONENT_ID, self._signing)
        self._started_ns: int | None = None
        self._wanted: dict[str, Value | None] = {}
        """Parameters to read, or to set to a value."""
        self._tries: dict[str, tuple[int, int]] = {}
        """Number of tries so far, and the time of the next one."""
        self._heartbeat_ns = -HEARTBEAT_PERIOD_NS

    @property
    def bad_signatures(self) -> int:
        """Number of messages that were refused, as they had no valid signature."""
        return self._codec.bad_signatures

    @property
    def done(self) -> bool:
        """Whether everything was replied to or given up."""
        return not self._wanted

    def read(self, names: Iterable[str]) -> None:
        """Ask for parameters."""
        self._wanted |= dict.fromkeys(names)

    def set(self, name: str, value: Value) -> None:
        """Set a parameter; it is done when the controller reports this value."""
        self._wanted[name] = value

    def step(self, data: bytes, now_ns: int) -> bytes:
        """Take in bytes of the link; returns those to send."""
        if self._started_ns is None:
            self._started_ns = now_ns
        if self._signing is not None:
            self._signing.clock_10us = self._since_2015_10us + (now_ns - self._started_ns) // 10_000
        for message in self._codec.parse(data):
            sender, kind = message.get_srcSystem(), message.get_msgId()
            if message.get_srcComponent() != CONTROLLER_ID:
                continue
            if kind == dialect.MAVLINK_MSG_ID_HEARTBEAT and self.system_id in (0, sender):
                self.system_id = sender
                if refusal := autopilot_refusal(message.autopilot):
                    self.refusal = refusal
                    self._wanted.clear()
            if kind == dialect.MAVLINK_MSG_ID_PARAM_VALUE and sender == self.system_id:
                self._on_value(message.param_id, decoded(message.param_value, message.param_type))
        out = b""
        if now_ns - self._heartbeat_ns >= HEARTBEAT_PERIOD_NS:  # PX4 replies on USB only to who sends it HEARTBEATs
            self._heartbeat_ns = now_ns
            kind, no_autopilot = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID
            out += self._codec.pack(dialect.MAVLink_heartbeat_message(kind, no_autopilot, 0, 0, 4, 3))
        return out + b"".join(self._due(now_ns)) if self.system_id else out

    def _on_value(self, name: str, value: Value) -> None:
        self.values[name] = value
        if name in self._wanted and self._wanted[name] in (None, value):
            del self._wanted[name]
            self._tries.pop(name, None)

    def _due(self, now_ns: int) -> Iterable[bytes]:
        for name in list(self._wanted)[:AT_ONCE]:
            tries, next_ns = self._tries.get(name, (0, now_ns))
            if now_ns < next_ns:
                continue
            if tries >= TRIES:
                del self._wanted[name]
                self._tries.pop(name, None)
                self.unknown.append(name)
                continue
            self._tries[name] = (tries + 1, now_ns + RETRY_PERIOD_NS)
            yield self._codec.pack(self._request(name))

    def _request(self, name: str) -> dialect.MAVLink_message:
        value, ascii_name = self._wanted[name], name.encode("ascii")
        if value is None:
            return dialect.MAVLink_param_request_read_message(self.system_id, CONTROLLER_ID, ascii_name, -1)
        carried, kind = encoded(value)
        return dialect.MAVLink_param_set_message(self.system_id, CONTROLLER_ID, ascii_name, carried, kind)
