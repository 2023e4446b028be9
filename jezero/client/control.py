"""Requests to the vehicle bridge, its fence among them, and about the goal in charge; the landing at the end."""

from collections.abc import Mapping
from typing import Any

import msgspec

from jezero.base.mistakes import mistake
from jezero.client.errors import Refused
from jezero.client.goal import await_pause, modify_goal, request_pause, resume_goal
from jezero.client.goal_sender import GoalSender
from jezero.client.session import Connection, decode
from jezero.client.status import REPLY_TIMEOUT_S, request_status
from jezero.schemas.commands import Abort, AbortReply, Hover, HoverReply, Kill, KillReply, Phase
from jezero.schemas.estimate import GetParameters, Lease, ParametersReply, SetParameters
from jezero.schemas.fence import Fence, FenceReply, FenceState, SetFence
from jezero.schemas.goals import Goal, LandOnSpotGoal
from jezero.schemas.rows import Action
from jezero.schemas.state import STATUS_WORDS, StatusCode
from jezero.schemas.topics import ABORT, FENCE, GET_PARAMETERS, HOVER, KILL, LAND_ON_SPOT, SET_FENCE, SET_PARAMETERS

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


def kill(connection: Connection, *, confirm: bool, vehicle: str) -> None:
    """See `Vehicle.kill`."""
    reply: KillReply = connection.request(KILL, Kill(confirm=confirm, vehicle=vehicle), DISARM_TIMEOUT_S)
    if not reply.killed:
        raise Refused(reply.reason)


def request_fence(connection: Connection) -> FenceState:
    """See `Vehicle.fence`."""
    arrivals = connection.stream(FENCE.name, b"", REPLY_TIMEOUT_S)
    state: FenceState = decode(FenceState, connection.first(arrivals, FENCE.name, REPLY_TIMEOUT_S))
    return state


def set_fence(connection: Connection, fence: Fence | None) -> None:
    """See `Vehicle.set_fence`."""
    if not isinstance(fence, Fence | None):
        raise ValueError(f"{fence!r} is no Fence: jezero.mission_files.read_fence reads one from a file")
    reply: FenceReply = connection.request(SET_FENCE, SetFence(fence=fence), REPLY_TIMEOUT_S)
    if not reply.accepted:
        raise Refused(reply.reason)


def estimator_parameters(connection: Connection) -> SetParameters:
    """See `Vehicle.estimator_parameters`."""
    return _parameters(connection.request(GET_PARAMETERS, GetParameters(), REPLY_TIMEOUT_S))


def estimator_lease(connection: Connection) -> Lease | None:
    """See `Vehicle.estimator_lease`."""
    reply: ParametersReply = connection.request(GET_PARAMETERS, GetParameters(), REPLY_TIMEOUT_S)
    return reply.lease


def set_estimator_parameters(connection: Connection, fields: Mapping[str, Any]) -> SetParameters:
    """See `Vehicle.set_estimator_parameters`."""
    try:
        request = msgspec.convert(dict(fields), SetParameters)
    except msgspec.ValidationError as error:
        raise ValueError(mistake(error, SetParameters)) from None
    return _parameters(connection.request(SET_PARAMETERS, request, REPLY_TIMEOUT_S))


def _parameters(reply: ParametersReply) -> SetParameters:
    if not reply.accepted or reply.parameters is None:
        raise Refused(reply.reason)
    return reply.parameters


def goal_in_charge(connection: Connection) -> tuple[Action[Any], str]:
    """Action and id of the goal in charge.

    Raises:
        Refused: there is none.
    """
    status = request_status(connection)
    if not status.goal_id:
        raise Refused(f"no goal is in charge, the vehicle {STATUS_WORDS[StatusCode(status.code)]}", status.code)
    # The keys follow from the name alone: the package of another client's action need not be installed here.
    return Action(status.action, Goal, Any, Any, Phase.ACTION), status.goal_id


def pause(connection: Connection) -> str:
    """See `Vehicle.pause`."""
    action, goal_id = goal_in_charge(connection)
    request_pause(connection, action, goal_id, REPLY_TIMEOUT_S)
    await_pause(connection, action, goal_id)
    return goal_id


def resume(connection: Connection) -> str:
    """See `Vehicle.resume`."""
    action, goal_id = goal_in_charge(connection)
    resume_goal(connection, action, goal_id, REPLY_TIMEOUT_S)
    return goal_id


def modify(connection: Connection, fields: Mapping[str, Any]) -> tuple[str, str]:
    """See `Vehicle.modify`."""
    action, goal_id = goal_in_charge(connection)
    return goal_id, modify_goal(connection, action, goal_id, fields)


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
