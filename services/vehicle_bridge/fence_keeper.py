"""Holds the vehicle inside the fence and its limits: limits targets, and brings back one that was pushed out of the
fence."""

from functools import partial

from jezero.fence import outside_reason, place_refusal, point_inside
from jezero.frames import Vec3
from jezero.schemas.fence import Fence
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge.config import OnFence
from jezero.services.vehicle_bridge.fence_limit import limited_target
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot
from jezero.services.vehicle_bridge.vehicle_limits import limit_walls, near_target, slowed_target
from jezero.vehicle_config import VehicleLimitsConfig

INSIDE_AGAIN_M = 0.2
"""A vehicle that was outside is inside again when it is this far inside: it doesn't leave twice on one edge."""
STOP_S = 2.0
"""A vehicle that was pushed out stops for this time before it returns."""
RETURN_M = 1.0
"""The vehicle returns to a point this far inside."""
NO_FLOOR = (StatusCode.TAKEOFF, StatusCode.LANDING, StatusCode.LANDING_DONE, StatusCode.ABORT)


class FenceKeeper:
    """Holds the vehicle inside a fence, and within its limits of height, distance and speed.

    Attributes:
        fence: the fence in force, its zones in metres; None for none.
        on_fence: what a vehicle does that was pushed out.
        outside: where and how far the vehicle is outside, for people; "" inside.
        limits: number of times that the fence or a limit began to limit the target.
        last_limit: the zone or limit that did so last, for people.
    """

    def __init__(self, on_fence: OnFence, limits: VehicleLimitsConfig) -> None:
        self._limits = limits
        self._limit_walls = partial(limit_walls, limits)
        self.fence: Fence | None = None
        self.on_fence = on_fence
        self.outside = self.last_limit = ""
        self.limits = 0
        self._is_limiting = False
        self._was_inside = False
        self._stopped_ns: int | None = None
        """Time since which the hover point is outside."""

    def update(self, vehicle: VehicleSnapshot) -> bool:
        """Update with the vehicle's position; returns whether it has just left the fence."""
        if self.fence is None or vehicle.pos_ned_m is None:
            self.outside, self._was_inside = "", False
            return False
        self.outside = outside_reason(self.fence, vehicle.pos_ned_m)
        left = self._was_inside and bool(self.outside)
        if self.outside:
            self._was_inside = False
            self._stopped_ns = None if left else self._stopped_ns
        elif not self._was_inside:
            self._was_inside = not outside_reason(self.fence, vehicle.pos_ned_m, margin_m=INSIDE_AGAIN_M)
        return left

    def limited(self, target: Target | None, vehicle: VehicleSnapshot, code: StatusCode) -> Target | None:
        """The target, or where that leads out of the fence or beyond the limits another one that doesn't."""
        if target is None or vehicle.landed:
            self._is_limiting = False
            return target
        target, slowed = slowed_target(self._limits, target)
        target, brought_near = near_target(self._limits, target, vehicle)
        target, limit = limited_target(
            self.fence, target, vehicle, floor_holds=code not in NO_FLOOR, limits=self._limit_walls
        )
        limit = limit or brought_near or slowed
        if limit and not self._is_limiting:
            self.limits, self.last_limit = self.limits + 1, limit
        self._is_limiting = bool(limit)
        return target

    def point_refusal(self, pos_ned_m: Vec3 | None) -> str:
        """Reason why the vehicle may not hover at a point, or ""."""
        if self.fence is None or pos_ned_m is None:
            return ""
        reason = place_refusal(self.fence, pos_ned_m, low_allowed=False)
        return f"the point is outside the fence {self.fence.name!r}: {reason}" if reason else ""

    def return_point(self, target: Target | None, vehicle: VehicleSnapshot) -> Vec3 | None:
        """Point inside to which a vehicle returns that has hovered outside for a while; None to stay."""
        point = None if target is None else target.pos_ned_m
        if self.fence is None or point is None or not outside_reason(self.fence, point):
            self._stopped_ns = None
            return None
        if self._stopped_ns is None:
            self._stopped_ns = vehicle.timer_ns
        stopped_s = (vehicle.timer_ns - self._stopped_ns) * 1e-9
        if self.on_fence != "return" or stopped_s < STOP_S:
            return None
        inside = point_inside(self.fence, point, RETURN_M)
        return None if outside_reason(self.fence, inside) else inside
