"""The exchanges of a flight, of the same size and over the same hops, with nothing but Zenoh in them.

`python -m benchmarks.speed.bare bridge PORT` and `... action` are the two ends; what arrives on PORT by UDP goes

    bridge -> router -> action -> router -> bridge -> UDP back to the sender   (odometry -> setpoint)
    client -> router -> action -> router -> bridge and back                    (goal -> accepted, first feedback)

All callbacks run in Zenoh's own threads. The reply on UDP carries the ns that Zenoh's part took.
"""

import socket
import sys
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Event
from typing import Any

import zenoh

from benchmarks.speed.mavlink_proxy import HOST
from jezero.base.codec import encode
from jezero.base.zenoh_client import client_config
from jezero.runtime.instance import Instance, instance_from_environment
from jezero.schemas.actions import Accepted, Feedback
from jezero.schemas.commands import Acquire, AcquireReply, Phase, Setpoint
from jezero.schemas.goals import GoToGoal, MoveFeedback
from jezero.schemas.state import Odometry

MAVLINK_SETPOINT_BYTES = 65
POINT = (1.2345678901234567, -2.3456789012345678, -3.4567890123456789)
GOAL_ID = "py-0123456789ab-12"

ODOMETRY = encode(
    Odometry(
        t_ns=123_456_000_000,
        epoch_id=123_456_789_012_345,
        pos_uav_ned_m=POINT,
        vel_uav_ned_mps=POINT,
        q_ned_from_frd=(0.9987654321, 0.0123456789, 0.0234567890, 0.0345678901),
        rates_uav_frd_rps=POINT,
        std_pos_m=0.2345678901234567,
        origin_deg=(47.397742, 8.545594, 488.0),
    )
)
SETPOINT = encode(
    Setpoint(
        t_ns=123_456_000_000,
        control_id="1f2e3d4c5b6a-12",
        sequence=1234,
        phase=Phase.GO_TO,
        reset_counter=0,
        pos_ned_m=POINT,
        vel_ned_mps=POINT,
        acc_ned_mps2=POINT,
        yaw_rad=0.1234567890123456,
    )
)
GOAL = encode(GoToGoal(goal_id=GOAL_ID, target_ned_m=POINT))
ACQUIRE = encode(Acquire(goal_id=GOAL_ID, action="go_to", do_takeoff=False))
GRANT = encode(AcquireReply(granted=True, control_id="1f2e3d4c5b6a-12", bridge_boot_id=123_456_789_012_345, grants=12))
ACCEPTED = encode(Accepted(goal_id=GOAL_ID))
FEEDBACK = encode(
    Feedback(
        goal_id=GOAL_ID,
        t_ns=123_456_000_000,
        code=4,
        feedback=MoveFeedback(pos_uav_ned_m=POINT, frame="world", distance_m=1.2345678901234567),
    )
)


def name(instance: Instance, exchange: str) -> str:
    """Key of one exchange; no service of the stack subscribes to it."""
    return f"bare/{instance.vehicle}/{exchange}"


def direct(callback: Any) -> "zenoh.handlers.Callback[Any]":
    """A callback that runs in the thread that receives."""
    return zenoh.handlers.Callback(callback, indirect=False)


def _ask(session: zenoh.Session, key: str, payload: bytes, on_reply: Any) -> None:
    session.get(
        key,
        direct(on_reply),
        target=zenoh.QueryTarget.BEST_MATCHING,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=5.0,
        payload=payload,
    )


def bridge(session: zenoh.Session, instance: Instance, port: int) -> None:
    """Turn UDP into odometry and setpoints into UDP, and grant control."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind((HOST, port))
    caller: list[Any] = []
    put_ns = 0
    odometry = session.declare_publisher(name(instance, "odometry"))

    def on_setpoint(_sample: zenoh.Sample) -> None:
        zenoh_ns = time.monotonic_ns() - put_ns
        link.sendto(zenoh_ns.to_bytes(8, "little").ljust(MAVLINK_SETPOINT_BYTES), caller[0])

    def on_acquire(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, GRANT)

    session.declare_subscriber(name(instance, "setpoint"), direct(on_setpoint))
    session.declare_queryable(name(instance, "acquire"), direct(on_acquire), complete=True)
    print("ready", flush=True)
    while True:
        _, sender = link.recvfrom(65536)
        caller[:] = [sender]
        put_ns = time.monotonic_ns()
        odometry.put(ODOMETRY)


def action(session: zenoh.Session, instance: Instance) -> None:
    """Reply to odometry with a setpoint. Request control for a goal, and reply to it twice."""
    setpoint = session.declare_publisher(name(instance, "setpoint"))

    def on_odometry(_sample: zenoh.Sample) -> None:
        setpoint.put(SETPOINT)

    def on_goal(query: zenoh.Query) -> None:
        def on_grant(_reply: zenoh.Reply) -> None:
            with query:
                query.reply(query.key_expr, ACCEPTED)
                query.reply(query.key_expr, FEEDBACK)

        _ask(session, name(instance, "acquire"), ACQUIRE, on_grant)

    session.declare_subscriber(name(instance, "odometry"), direct(on_odometry))
    session.declare_queryable(name(instance, "goal"), direct(on_goal), complete=True)
    print("ready", flush=True)
    Event().wait()


def request_goal(session: zenoh.Session, instance: Instance) -> tuple[float, float]:
    """Seconds from a goal to its two replies, in a waiting thread.

    Raises:
        RuntimeError: an end doesn't reply.
    """
    replies: SimpleQueue[Any] = SimpleQueue()
    begin_s = time.perf_counter()
    _ask(session, name(instance, "goal"), GOAL, replies.put)
    try:
        replies.get(timeout=5)
        accepted_s = time.perf_counter() - begin_s
        replies.get(timeout=5)
    except Empty:
        raise RuntimeError("the bare exchange does not reply") from None
    return accepted_s, time.perf_counter() - begin_s


def run_end(
    bridge: Callable[[zenoh.Session, Instance, int], None], action: Callable[[zenoh.Session, Instance], None]
) -> None:
    """Run one of two ends by the command line: `bridge PORT` or `action`."""
    role, instance = sys.argv[1], instance_from_environment()
    with zenoh.open(client_config(instance.router)) as session:
        if role == "bridge":
            bridge(session, instance, int(sys.argv[2]))
        else:
            action(session, instance)


if __name__ == "__main__":
    run_end(bridge, action)
