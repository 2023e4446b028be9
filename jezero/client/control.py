"""Requests to the vehicle bridge, hover, abort and kill, and the landing at the end of a flight."""

from jezero.client.errors import Refused
from jezero.client.goal_sender import GoalSender
from jezero.client.session import Connection
from jezero.client.status import REPLY_TIMEOUT_S, request_status
from jezero.schemas.actions import LandOnSpotGoal
from jezero.schemas.commands import Abort, AbortReply, Hover, HoverReply, Kill, KillReply
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ABORT, HOVER, KILL, LAND_ON_SPOT

HOVER_TIMEOUT_S = 10.0
"""Longest wait for a hover: a goal that ends near the ground climbs first, and taking control back takes seconds."""
DISARM_TIMEOUT_S = 15.0


def hover(connection: Connection, pos_ned_m: tuple[float, float, float] | None) -> None:
    """See `Vehicle.hover`."""
    reply: HoverReply = connection.request(HOVER, Hover(hover_pos=pos_ned_m), HOVER_TIMEOUT_S)
    if not reply.hover_mode:
        raise Refused(reply.reason)


def abort(connection: Connection, reason: str) -> AbortReply:
    """See `Vehicle.abort`."""
    reply: AbortReply = connection.request(ABORT, Abort(reason=reason), REPLY_TIMEOUT_S)
    return reply


def kill(connection: Connection, *, confirm: bool) -> None:
    """See `Vehicle.kill`."""
    reply: KillReply = connection.request(KILL, Kill(confirm=confirm), DISARM_TIMEOUT_S)
    if not reply.killed:
        raise Refused(reply.reason)


def land_here(connection: Connection, goals: GoalSender) -> None:
    """Land at the vehicle's position, unless it stands already or a pilot or a failsafe has taken over.

    Raises:
        Refused, Aborted, Canceled, Unreachable, TimedOut: the hover or the landing failed.
    """
    status = request_status(connection)
    if status.code in (StatusCode.IDLE, StatusCode.EXTERNAL):
        return
    if status.code != StatusCode.HOVER:
        hover(connection, None)
        status = request_status(connection)
    spot_ned_m = None if status.odometry is None else status.odometry.pos_uav_ned_m
    goals.send(LAND_ON_SPOT, LandOnSpotGoal(landing_spot_ned_m=spot_ned_m, use_uwb=False, use_tag=False)).result()
