"""Gives the autopilot the fence as its own geofence, by MAVLink's mission protocol.

Source: https://mavlink.io/en/services/mission.html, with MAV_MISSION_TYPE_FENCE.
"""

from jezero.frames import Vec3, geodetic_from_ned
from jezero.mavlink import MavMessage, dialect
from jezero.schemas.fence import Fence, Zone

MARGIN_M = 2.0
"""The autopilot's fence is this much wider, so that the bridge acts first."""
RETRY_PERIOD_NS = 1_000_000_000
TRIES = 5
FENCE_TYPE = dialect.MAV_MISSION_TYPE_FENCE
KEEP_IN = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION)
KEEP_OUT = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)

Corner = tuple[float, float]
Item = tuple[int, int, Corner]
"""Command, number of corners of its polygon, and latitude and longitude of one corner."""


def autopilot_items(fence: Fence, origin_deg: Vec3) -> list[Item]:
    """The fence's zones, widened by `MARGIN_M`; a small zone to stay out of that vanishes so is left out."""
    items: list[Item] = []
    for zone in fence.zones:
        keep_in = zone is fence.keep_in
        corners_m = _widened(zone, MARGIN_M if keep_in else -MARGIN_M)
        command = KEEP_IN if keep_in else KEEP_OUT
        for north_m, east_m in corners_m:
            latitude_deg, longitude_deg, _ = geodetic_from_ned((north_m, east_m, 0.0), origin_deg)
            items.append((command, len(corners_m), (latitude_deg, longitude_deg)))
    return items


def _widened(zone: Zone, by_m: float) -> list[Corner]:
    from shapely.geometry import MultiPolygon, Polygon  # takes half a second, and most vehicles have no fence

    area = Polygon(zone.corners_ned_m).buffer(0.0).buffer(by_m, join_style="mitre")
    if isinstance(area, MultiPolygon):
        area = max(area.geoms, key=lambda part: part.area)
    return [] if area.is_empty else [(north, east) for north, east in area.exterior.coords[:-1]]


class FenceUpload:
    """Sends a fence to the autopilot, and sends its announcement again until the autopilot has acknowledged it.

    Attributes:
        failure: why the autopilot has not taken the fence, for people; "" for no failure.
        done: the autopilot has acknowledged the fence.
    """

    def __init__(self, system_id: int) -> None:
        self.failure = ""
        self.done = False
        self._system_id = system_id
        self._items: list[Item] | None = None
        self._tries = 0
        self._next_ns = 0

    def start(self, items: list[Item]) -> None:
        """Send a fence."""
        self._items, self._tries, self._next_ns = items, 0, 0
        self.failure, self.done = "", False

    def clear(self) -> None:
        """Take away the fence that was sent; one that somebody else has stored in the autopilot stays."""
        if self._items is not None:
            self.start([])

    def restart(self) -> None:
        """Send the fence again, to an autopilot that has restarted."""
        if self._items is not None:
            self.start(self._items)

    def due(self, timer_ns: int) -> MavMessage | None:
        """The announcement of the fence, when it is due."""
        if self._items is None or self.done or self.failure or timer_ns < self._next_ns:
            return None
        if self._tries >= TRIES:
            self.failure = "the autopilot doesn't reply"
            return None
        self._tries += 1
        self._next_ns = timer_ns + RETRY_PERIOD_NS
        return dialect.MAVLink_mission_count_message(self._system_id, 1, len(self._items), FENCE_TYPE)

    def on_message(self, message: MavMessage, timer_ns: int) -> MavMessage | None:
        """Handle MISSION_REQUEST, MISSION_REQUEST_INT or MISSION_ACK; returns the item that was requested."""
        if message.mission_type != FENCE_TYPE or self._items is None or self.done:
            return None
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            self.done = message.type == dialect.MAV_MISSION_ACCEPTED
            if not self.done:
                self.failure = f"the autopilot refuses it with MAV_MISSION_RESULT {message.type}"
            return None
        if message.seq >= len(self._items):
            return None
        self._next_ns = timer_ns + RETRY_PERIOD_NS
        command, corners, (latitude_deg, longitude_deg) = self._items[message.seq]
        return dialect.MAVLink_mission_item_int_message(
            self._system_id, 1, message.seq, dialect.MAV_FRAME_GLOBAL_INT, command, 0, 1,
            float(corners), 0.0, 0.0, 0.0, round(latitude_deg * 1e7), round(longitude_deg * 1e7), 0.0, FENCE_TYPE,
        )  # fmt: skip
