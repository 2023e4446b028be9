"""The fence in force: set on the ground, placed around the vehicle's origin, published once a second."""

from collections.abc import Callable, Iterator
from zlib import crc32

from jezero.codec import encode
from jezero.fence import fence_refusal, placed
from jezero.frames import Vec3
from jezero.runtime.service import Inbox, Output, Publish, Reply
from jezero.schemas.fence import Fence, FenceReply, FenceState
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import FENCE, SET_FENCE
from jezero.services.vehicle_bridge.fence_keeper import FenceKeeper
from jezero.services.vehicle_bridge.fence_upload import FenceUpload, autopilot_items
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot

PERIOD_NS = 1_000_000_000
IN_FLIGHT = "the fence can't change while the vehicle is armed: land and disarm first"


class FenceHolder:
    """Holds the fence.

    Args:
        keeper: gets the fence whenever it changes.
        upload: gives it to the autopilot.
        fence: the fence at the start.
        keep: gets the fence of each request.

    Attributes:
        fence_id: changes with the fence and with its place; "" without a fence.
    """

    def __init__(
        self,
        keeper: FenceKeeper,
        upload: FenceUpload,
        fence: Fence | None = None,
        keep: Callable[[Fence | None], None] = lambda fence: None,
    ) -> None:
        self._keeper = keeper
        self._upload = upload
        self._uploaded: tuple[str, Vec3 | None] = ("", None)
        """Id of the autopilot's own fence, and the origin around which it was placed."""
        self._fence = fence
        self._keep = keep
        self._origin_deg: Vec3 | None = None
        self._published: FenceState | None = None
        self._published_wall_ns = 0
        self.fence_id = ""
        self._place()

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
            self._fence = fence
            self._keep(self._fence)
            self._place()
            yield Reply(request.request_id, FenceReply(accepted=True))

    def update(self, origin_deg: Vec3 | None, vehicle: VehicleSnapshot, wall_ns: int) -> Iterator[Output]:
        """Place zones in degrees anew where the origin has changed, and publish when it is due."""
        if origin_deg != self._origin_deg:
            self._origin_deg = origin_deg
            self._place()
        if self._uploaded != (self.fence_id, origin_deg):
            self._give_to_autopilot()
        placed_fence, outside = self._keeper.fence, self._keeper.outside
        last = self._published
        changed = last is None or last.fence_id != self.fence_id or bool(last.outside) is not bool(outside)
        if changed or wall_ns - self._published_wall_ns >= PERIOD_NS:
            self._published_wall_ns = wall_ns
            self._published = FenceState(
                t_ns=max(0, vehicle.t_ns),
                fence=placed_fence,
                fence_id=self.fence_id,
                outside=outside,
                autopilot_failure=self._upload.failure,
            )
            yield Publish(FENCE, self._published)

    @property
    def health_text(self) -> str:
        """What the fence does now and has done, for people; "" for nothing."""
        keeper, text = self._keeper, ""
        if keeper.outside:
            text += "; the vehicle is outside the fence"
        if keeper.limits:
            text += f"; held back {keeper.limits} times, the last time by {keeper.last_limit}"
        if self._upload.failure:
            text += f"; the autopilot's own fence is not set: {self._upload.failure}"
        return text

    def _give_to_autopilot(self) -> None:
        fence, origin_deg = self._keeper.fence, self._origin_deg
        if fence is not None and origin_deg is not None:
            self._upload.start(autopilot_items(fence, origin_deg))
        elif self._fence is None:
            self._upload.clear()
        else:
            return  # the fence waits for the origin
        self._uploaded = (self.fence_id, origin_deg)

    def _place(self) -> None:
        self._keeper.fence = None if self._fence is None else placed(self._fence, self._origin_deg)
        fence = self._keeper.fence or self._fence
        self.fence_id = "" if fence is None else f"{crc32(encode(fence)):08x}"
