"""What the bridge does with a fence: sets it on the ground, holds the vehicle inside, and gives it to the autopilot.

`FenceKeeper` has the fence in force from the request that sets it to the target in front of it; how a target is limited
is in `motion_limits`. `FenceUpload` sends the same fence to the autopilot as its own geofence.
"""

from collections.abc import Callable, Iterator
from zlib import crc32

from shapely.geometry import MultiPolygon, Polygon  # now, as no step of the bridge has time for this import

from jezero.base.codec import encode
from jezero.base.fence import fence_refusal, outside_reason, place_refusal, placed, point_inside
from jezero.base.frames import Vec3, geodetic_from_ned
from jezero.base.mavlink import MavMessage, dialect
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.runtime.service import Inbox, Output, Publish, Reply
from jezero.schemas.fence import Fence, FenceReply, FenceState, Zone
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import FENCE, SET_FENCE
from jezero.services.vehicle_bridge.config import OnFence
from jezero.services.vehicle_bridge.motion_limits import EDGE_M, inward_target, limited_target
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot

PERIOD_NS = 1_000_000_000
IN_FLIGHT = "the fence can't change while the vehicle is armed: land and disarm first"
INSIDE_AGAIN_M = 0.2
"""A vehicle that was outside is inside again when it is this far inside: it doesn't leave twice on one edge."""
STOP_S = 2.0
"""A vehicle that was pushed out stops for this time before it returns."""
RETURN_M = 1.0
"""The vehicle returns to a point this far inside."""
NO_FLOOR = (StatusCode.TAKEOFF, StatusCode.LANDING, StatusCode.LANDING_DONE, StatusCode.ABORT)


class FenceKeeper:
    """Keeps the fence in force: sets it on the ground, places it around the vehicle's origin, publishes it once a
    second, and holds the vehicle inside it and within its limits of height, distance and speed.

    Args:
        on_fence: what a vehicle does that was pushed out.
        limits: the vehicle's limits.
        upload: gives the fence to the autopilot.
        fence: the fence at the start.
        keep: gets the fence of each request.

    Attributes:
        fence_id: changes with the fence and with its place; "" without a fence.
        on_fence: what a vehicle does that was pushed out.
        outside: where and how far the vehicle is outside, for people; "" inside.
    """

    def __init__(
        self,
        on_fence: OnFence,
        limits: VehicleLimitsConfig,
        upload: "FenceUpload",
        fence: Fence | None = None,
        keep: Callable[[Fence | None], None] = lambda fence: None,
    ) -> None:
        self.on_fence = on_fence
        self.outside = self.fence_id = ""
        self._limits = limits
        self._upload = upload
        self._uploaded: tuple[str, Vec3 | None] = ("", None)
        """Id of the autopilot's own fence, and the origin around which it was placed."""
        self._set_fence = fence
        """The fence as it was set; its zones may be in degrees."""
        self._fence: Fence | None = None
        """The fence in force, its zones in metres; None for none, and before the origin that places it is known."""
        self._keep = keep
        self._origin_deg: Vec3 | None = None
        self._published: FenceState | None = None
        self._published_wall_ns = 0
        self._is_limiting = False
        self._limit_count, self._last_limit = 0, ""
        """Number of times that a target began to be limited, and the zone or limit that did so last, for people."""
        self._was_inside = False
        self._stopped_ns: int | None = None
        """Time since which the hover point is outside."""
        self._place()

    # -- the fence in force ------------------------------------------------------------------------------

    def handle(self, code: StatusCode, vehicle: VehicleSnapshot, inbox: Inbox) -> Iterator[Output]:
        """Set the fence by the requests that have come, on the ground only, and only one that can be meant."""
        for request in inbox.requests(SET_FENCE):
            if code is not StatusCode.IDLE or vehicle.armed is not False:
                yield Reply(request.request_id, FenceReply(accepted=False, reason=IN_FLIGHT))
                continue
            fence = request.payload.fence
            if fence is not None and (reason := fence_refusal(fence, self._origin_deg)):
                yield Reply(request.request_id, FenceReply(accepted=False, reason=f"the fence is refused: {reason}"))
                continue
            self._set_fence = fence
            self._keep(fence)
            self._place()
            yield Reply(request.request_id, FenceReply(accepted=True))

    def publish(self, origin_deg: Vec3 | None, vehicle: VehicleSnapshot, wall_ns: int) -> Iterator[Output]:
        """Place zones in degrees anew where the origin has changed, and publish when it is due."""
        if origin_deg != self._origin_deg:
            self._origin_deg = origin_deg
            self._place()
        if self._uploaded != (self.fence_id, origin_deg):
            self._give_to_autopilot()
        last = self._published
        changed = last is None or last.fence_id != self.fence_id or bool(last.outside) is not bool(self.outside)
        if changed or wall_ns - self._published_wall_ns >= PERIOD_NS:
            self._published_wall_ns = wall_ns
            self._published = FenceState(
                t_ns=max(0, vehicle.t_ns),
                fence=self._fence,
                fence_id=self.fence_id,
                outside=self.outside,
                autopilot_failure=self._upload.failure,
            )
            yield Publish(FENCE, self._published)

    @property
    def health_text(self) -> str:
        """What the fence does now and has done, for people; "" for nothing."""
        text = ""
        if self.outside:
            text += "; the vehicle is outside the fence"
        if self._limit_count:
            text += f"; held back {self._limit_count} times, the last time by {self._last_limit}"
        if self._upload.failure:
            text += f"; the autopilot's own fence is not set: {self._upload.failure}"
        return text

    def _place(self) -> None:
        self._fence = None if self._set_fence is None else placed(self._set_fence, self._origin_deg)
        fence = self._fence or self._set_fence
        self.fence_id = "" if fence is None else f"{crc32(encode(fence)):08x}"

    def _give_to_autopilot(self) -> None:
        if self._fence is not None and self._origin_deg is not None:
            self._upload.start(autopilot_items(self._fence, self._origin_deg))
        elif self._set_fence is None:
            self._upload.clear()
        else:
            return  # the fence waits for the origin
        self._uploaded = (self.fence_id, self._origin_deg)

    # -- the vehicle inside it ---------------------------------------------------------------------------

    def update(self, vehicle: VehicleSnapshot) -> bool:
        """Update with the vehicle's position; returns whether it has just left the fence."""
        if self._fence is None or vehicle.pos_ned_m is None:
            self.outside, self._was_inside = "", False
            return False
        self.outside = outside_reason(self._fence, vehicle.pos_ned_m)
        left = self._was_inside and bool(self.outside)
        if self.outside:
            self._was_inside = False
            self._stopped_ns = None if left else self._stopped_ns
        elif not self._was_inside:
            self._was_inside = not outside_reason(self._fence, vehicle.pos_ned_m, margin_m=INSIDE_AGAIN_M)
        return left

    def limited(
        self, target: Target | None, vehicle: VehicleSnapshot, code: StatusCode, *, by_goal: bool
    ) -> Target | None:
        """The target, or where that leads out of the fence or beyond the limits another one that doesn't.

        The target of a goal (`by_goal`) that began outside leads inside first, where the vehicle would also return by
        itself: otherwise a goal that rises, or waits, would stay outside.
        """
        if target is None or vehicle.landed:
            self._is_limiting = False
            return target
        pos_ned_m = vehicle.pos_ned_m
        if by_goal and self.outside and self.on_fence == "return" and self._fence is not None and pos_ned_m is not None:
            target = inward_target(target, pos_ned_m, point_inside(self._fence, pos_ned_m, EDGE_M))
        target, limit = limited_target(self._fence, self._limits, target, vehicle, floor_holds=code not in NO_FLOOR)
        if limit and not self._is_limiting:
            self._limit_count, self._last_limit = self._limit_count + 1, limit
        self._is_limiting = bool(limit)
        return target

    def point_refusal(self, pos_ned_m: Vec3 | None) -> str:
        """Reason why the vehicle may not hover at a point, or ""."""
        if self._fence is None or pos_ned_m is None:
            return ""
        reason = place_refusal(self._fence, pos_ned_m, low_allowed=False)
        return f"the point is outside the fence {self._fence.name!r}: {reason}" if reason else ""

    def return_point(self, target: Target | None, vehicle: VehicleSnapshot) -> Vec3 | None:
        """Point inside to which a vehicle returns that has hovered outside for a while; None to stay."""
        point = None if target is None else target.pos_ned_m
        if self._fence is None or point is None or not outside_reason(self._fence, point):
            self._stopped_ns = None
            return None
        if self._stopped_ns is None:
            self._stopped_ns = vehicle.timer_ns
        stopped_s = (vehicle.timer_ns - self._stopped_ns) * 1e-9
        if self.on_fence != "return" or stopped_s < STOP_S:
            return None
        inside = point_inside(self._fence, point, RETURN_M)
        return None if outside_reason(self._fence, inside) else inside


# -- the autopilot's own fence ---------------------------------------------------------------------------

AUTOPILOT_MARGIN_M = 2.0
"""The autopilot's fence is this much wider, so that the bridge acts first."""
RETRY_PERIOD_NS = 1_000_000_000
TRIES = 5
FENCE_TYPE = dialect.MAV_MISSION_TYPE_FENCE
KEEP_IN = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION)
KEEP_OUT = int(dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)

Corner = tuple[float, float]
Item = tuple[int, int, Corner]
"""Command, number of corners of its polygon, and latitude and longitude of one corner."""


class FenceUpload:
    """Sends a fence to the autopilot, and sends its announcement again until the autopilot has acknowledged it.

    Source: https://mavlink.io/en/services/mission.html, with MAV_MISSION_TYPE_FENCE.

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
            refusal = f"the autopilot refuses it with MAV_MISSION_RESULT {message.type}"
            self.failure = "" if self.done else refusal
            return None
        if message.seq >= len(self._items):
            return None
        self._next_ns = timer_ns + RETRY_PERIOD_NS
        command, corners, (latitude_deg, longitude_deg) = self._items[message.seq]
        return dialect.MAVLink_mission_item_int_message(
            self._system_id, 1, message.seq, dialect.MAV_FRAME_GLOBAL_INT, command, 0, 1,
            float(corners), 0.0, 0.0, 0.0, round(latitude_deg * 1e7), round(longitude_deg * 1e7), 0.0, FENCE_TYPE,
        )  # fmt: skip


def autopilot_items(fence: Fence, origin_deg: Vec3) -> list[Item]:
    """The fence's zones, widened by `AUTOPILOT_MARGIN_M`; a small zone to stay out of that vanishes so is left out."""
    items: list[Item] = []
    for zone in fence.zones:
        keep_in = zone is fence.keep_in
        corners_m = _widened(zone, AUTOPILOT_MARGIN_M if keep_in else -AUTOPILOT_MARGIN_M)
        command = KEEP_IN if keep_in else KEEP_OUT
        for north_m, east_m in corners_m:
            latitude_deg, longitude_deg, _ = geodetic_from_ned((north_m, east_m, 0.0), origin_deg)
            items.append((command, len(corners_m), (latitude_deg, longitude_deg)))
    return items


def _widened(zone: Zone, by_m: float) -> list[Corner]:
    area = Polygon(zone.corners_ned_m).buffer(0.0).buffer(by_m, join_style="mitre")
    if isinstance(area, MultiPolygon):
        area = max(area.geoms, key=lambda part: part.area)
    return [] if area.is_empty else [(north, east) for north, east in area.exterior.coords[:-1]]
