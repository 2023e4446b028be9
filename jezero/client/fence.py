"""The fence of one vehicle."""

from jezero.client.errors import Refused
from jezero.client.session import Connection, decode
from jezero.client.status import REPLY_TIMEOUT_S
from jezero.schemas.fence import Fence, FenceReply, FenceState, SetFence
from jezero.schemas.topics import FENCE, SET_FENCE


def request_fence(connection: Connection) -> FenceState:
    """See `Vehicle.fence`."""
    arrivals = connection.stream(FENCE.name, b"", REPLY_TIMEOUT_S)
    state: FenceState = decode(FenceState, connection.first(arrivals, FENCE.name, REPLY_TIMEOUT_S))
    return state


def set_fence(connection: Connection, fence: Fence | None) -> None:
    """See `Vehicle.set_fence`."""
    reply: FenceReply = connection.request(SET_FENCE, SetFence(fence=fence), REPLY_TIMEOUT_S)
    if not reply.accepted:
        raise Refused(reply.reason)
