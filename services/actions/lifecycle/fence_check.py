"""Refusal of a goal whose planned way leaves the fence."""

from collections.abc import Sequence

from jezero.fence_geometry import way_refusal
from jezero.frames import Vec3
from jezero.runtime.service import Inbox
from jezero.schemas.topics import FENCE, STATUS
from jezero.services.actions.motion.behaviour import Plan

UNKNOWN = "the vehicle's fence is not known yet: send the goal again in a second"


def fence_refusal(way_ned_m: Sequence[Vec3], plan: Plan, inbox: Inbox) -> str:
    """Reason why a goal leaves the fence, or ""; an unknown way is not judged."""
    status, state = inbox.latest(STATUS), inbox.latest(FENCE)
    if status is None or not status.fence_id:
        return ""
    if state is None or state.fence is None or state.fence_id != status.fence_id:
        return UNKNOWN
    return way_refusal(state.fence, way_ned_m, from_ground=plan.do_takeoff, to_ground=plan.lands)
