"""The geofence that ground stations and companions store in the autopilot; it is kept and given back, not flown by.

Source: https://mavlink.io/en/services/mission.html, with MAV_MISSION_TYPE_FENCE.
"""

from jezero.base.mavlink import MavMessage, dialect
from jezero.services.autopilot.telemetry import TelemetryLink

FENCE_TYPE = dialect.MAV_MISSION_TYPE_FENCE
ITEMS_MAX = 1000
VERTICES = (dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)


class StoredFence:
    """Takes and gives the items of one fence.

    Attributes:
        items: the MISSION_ITEM_INT messages of the fence that was stored last.
    """

    def __init__(self) -> None:
        self.items: list[MavMessage] = []
        self._incoming: list[MavMessage] = []
        self._count = 0

    def on_count(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Begin an upload: request its first item."""
        if message.count > ITEMS_MAX:
            return _acknowledge(link, message, dialect.MAV_MISSION_NO_SPACE)
        self._incoming, self._count = [], message.count
        return self._request_next(link, message)

    def on_item(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Take an item, and request the next one."""
        if message.seq != len(self._incoming) or message.seq >= self._count:
            return b""  # a repetition of one that has come already
        if message.command not in VERTICES:
            self._count = 0
            return _acknowledge(link, message, dialect.MAV_MISSION_UNSUPPORTED)
        self._incoming.append(message)
        return self._request_next(link, message)

    def _request_next(self, link: TelemetryLink, message: MavMessage) -> bytes:
        number, sender = len(self._incoming), (message.get_srcSystem(), message.get_srcComponent())
        if number < self._count:
            return link.pack(dialect.MAVLink_mission_request_int_message(*sender, number, FENCE_TYPE))
        self.items, self._incoming, self._count = self._incoming, [], 0
        return _acknowledge(link, message, dialect.MAV_MISSION_ACCEPTED)

    def send_count(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Reply to a download with the number of items."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        return link.pack(dialect.MAVLink_mission_count_message(*sender, len(self.items), FENCE_TYPE))

    def send_item(self, link: TelemetryLink, message: MavMessage) -> bytes:
        """Reply to a request for one item."""
        if message.seq >= len(self.items):
            return _acknowledge(link, message, dialect.MAV_MISSION_INVALID_SEQUENCE)
        m, sender = self.items[message.seq], (message.get_srcSystem(), message.get_srcComponent())
        return link.pack(
            dialect.MAVLink_mission_item_int_message(
                *sender, m.seq, m.frame, m.command, 0, 1, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z,
                FENCE_TYPE,
            )
        )  # fmt: skip


def _acknowledge(link: TelemetryLink, message: MavMessage, result: int) -> bytes:
    sender = (message.get_srcSystem(), message.get_srcComponent())
    return link.pack(dialect.MAVLink_mission_ack_message(*sender, result, FENCE_TYPE))
