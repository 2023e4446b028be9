"""Refusal of a goal whose planned way leaves the fence."""

from collections.abc import Sequence

from jezero.fence import way_refusal
from jezero.frames import Vec3
from jezero.runtime.service import Inbox
from jezero.schemas.fence import Fence
from jezero.schemas.topics import FENCE, STATUS
from jezero.services.actions.motion.behaviour import Plan

UNKNOWN = "the vehicle's fence is not known yet: send the goal again in a second"


def known_fence(inbox: Inbox) -> Fence | None:
    """The fence in force; None for none, and while it is unknown."""
    status, state = inbox.latest(STATUS), inbox.latest(FENCE)
    if status is None or state is None or state.fence_id != status.fence_id:
        return None
    return state.fence


def fence_refusal(way_ned_m: Sequence[Vec3], plan: Plan, inbox: Inbox) -> str:
    """Reason why a goal leaves the fence, or ""; an unknown way is not judged."""
    status, fence = inbox.latest(STATUS), known_fence(inbox)
    if status is None or not status.fence_id:
        return ""
    if fence is None:
        return UNKNOWN
    return way_refusal(fence, way_ned_m, from_ground=plan.do_takeoff, to_ground=plan.lands)
