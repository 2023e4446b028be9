"""The exchanges of a flight as a script would do them with pymavlink, json and Zenoh alone.

`python -m benchmarks.speed.by_hand bridge PORT` and `... action` are the two ends, over the same hops as
`benchmarks.speed.bare`. The ends parse and pack MAVLink, read and write JSON, and compute setpoints.
They check nothing, grant control to every goal, and are not restarted.
"""

import json
import socket
import time
from threading import Event
from typing import Any

import zenoh
from pymavlink.dialects.v20 import common as dialect

from benchmarks.speed.bare import run_end
from benchmarks.speed.mavlink_proxy import HOST
from jezero.runtime.instance import Instance

TARGET_NED_M = (3.0, 0.0, -3.0)
ORIGIN_DEG = (47.397742, 8.545594, 488.0)
SYSTEM_ID, COMPONENT_ID = 1, 191
EPOCH_ID = 123_456_789_012_345
CONTROL_ID = "1f2e3d4c5b6a-12"
GOAL_ID = "py-0123456789ab-12"


def name(instance: Instance, exchange: str) -> str:
    """Key of one exchange; no service of the stack subscribes to it."""
    return f"by_hand/{instance.vehicle}/{exchange}"


def _query(session: zenoh.Session, key: str, request: dict[str, Any]) -> Any:
    """Query; yields replies as they arrive, which Zenoh by default delivers after the last one."""
    return session.get(key, payload=json.dumps(request), consolidation=zenoh.ConsolidationMode.NONE, timeout=5.0)


def _read(sample: Any) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(sample.payload.to_bytes())
    return message


def bridge(session: zenoh.Session, instance: Instance, port: int) -> None:
    """Turn ODOMETRY into odometry and setpoints into SET_POSITION_TARGET_LOCAL_NED, and grant control."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind((HOST, port))
    mav = dialect.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=COMPONENT_ID)
    caller: list[Any] = []
    odometry = session.declare_publisher(name(instance, "odometry"))

    def on_setpoint(sample: zenoh.Sample) -> None:
        setpoint = _read(sample)
        message = dialect.MAVLink_set_position_target_local_ned_message(
            setpoint["t_ns"] // 1_000_000 & 0xFFFFFFFF,
            SYSTEM_ID,
            dialect.MAV_COMP_ID_AUTOPILOT1,
            dialect.MAV_FRAME_LOCAL_NED,
            0,
            *(*setpoint["pos_ned_m"], *setpoint["vel_ned_mps"], *setpoint["acc_ned_mps2"]),
            setpoint["yaw_rad"],
            0.0,
        )
        link.sendto(bytes(message.pack(mav)), caller[0])

    def on_acquire(query: zenoh.Query) -> None:
        goal_id = _read(query)["goal_id"]
        with query:
            granted = {"granted": True, "goal_id": goal_id, "control_id": CONTROL_ID, "bridge_boot_id": EPOCH_ID}
            query.reply(query.key_expr, json.dumps(granted))

    kept = (
        session.declare_subscriber(name(instance, "setpoint"), on_setpoint),
        session.declare_queryable(name(instance, "acquire"), on_acquire),
    )
    print("ready", flush=True)
    while kept:
        data, sender = link.recvfrom(65536)
        caller[:] = [sender]
        for message in mav.parse_buffer(data) or []:
            if message.get_type() == "ODOMETRY":
                odometry.put(json.dumps(_odometry(message)))


def _odometry(message: Any) -> dict[str, Any]:
    return {
        "t_ns": message.time_usec * 1000,
        "epoch_id": EPOCH_ID,
        "pos_uav_ned_m": [message.x, message.y, message.z],
        "vel_uav_ned_mps": [message.vx, message.vy, message.vz],
        "q_ned_from_frd": list(message.q),
        "rates_uav_frd_rps": [message.rollspeed, message.pitchspeed, message.yawspeed],
        "std_pos_m": message.pose_covariance[0] ** 0.5,
        "origin_deg": ORIGIN_DEG,
        "reset_counter": message.reset_counter,
    }


def action(session: zenoh.Session, instance: Instance) -> None:
    """Reply to odometry with a setpoint. Request control for a goal, and reply to it twice."""
    setpoint = session.declare_publisher(name(instance, "setpoint"))
    sequence = 0

    def on_odometry(sample: zenoh.Sample) -> None:
        nonlocal sequence
        sequence += 1
        setpoint.put(json.dumps(_setpoint(_read(sample), sequence)))

    def on_goal(query: zenoh.Query) -> None:
        goal = _read(query)
        acquire = {"goal_id": goal["goal_id"], "action": "go_to", "do_takeoff": False}
        with query:
            for reply in _query(session, name(instance, "acquire"), acquire):
                if _read(reply.ok)["granted"]:
                    query.reply(query.key_expr, json.dumps({"accepted": True, "goal_id": goal["goal_id"]}))
                    query.reply(query.key_expr, json.dumps(_feedback(goal)))

    kept = (
        session.declare_subscriber(name(instance, "odometry"), on_odometry),
        session.declare_queryable(name(instance, "goal"), on_goal),
    )
    print("ready", flush=True)
    Event().wait()
    del kept


def _setpoint(odometry: dict[str, Any], sequence: int) -> dict[str, Any]:
    """A setpoint towards the target, in proportion to the remaining distance."""
    left_m = [there - here for there, here in zip(TARGET_NED_M, odometry["pos_uav_ned_m"], strict=True)]
    return {
        "t_ns": odometry["t_ns"],
        "control_id": CONTROL_ID,
        "sequence": sequence,
        "phase": "go_to",
        "reset_counter": odometry["reset_counter"],
        "pos_ned_m": [here + 0.1 * x for here, x in zip(odometry["pos_uav_ned_m"], left_m, strict=True)],
        "vel_ned_mps": [0.5 * x for x in left_m],
        "acc_ned_mps2": [0.1 * x for x in left_m],
        "yaw_rad": 0.1234567890123456,
    }


def _feedback(goal: dict[str, Any]) -> dict[str, Any]:
    moved = {"pos_uav_ned_m": goal["target_ned_m"], "frame": "world", "distance_m": 1.2345678901234567}
    return {"goal_id": goal["goal_id"], "t_ns": time.monotonic_ns(), "code": 4, "feedback": moved}


def request_goal(session: zenoh.Session, instance: Instance) -> tuple[float, float]:
    """Seconds from a goal to its two decoded replies.

    Raises:
        RuntimeError: an end doesn't reply.
    """
    begin_s = time.perf_counter()
    taken_s = []
    goal = {"goal_id": GOAL_ID, "target_ned_m": TARGET_NED_M, "frame": "world"}
    for reply in _query(session, name(instance, "goal"), goal):
        if reply.ok is not None:
            _read(reply.ok)
            taken_s.append(time.perf_counter() - begin_s)
    if len(taken_s) != 2:
        raise RuntimeError("the exchange by hand does not reply")
    return taken_s[0], taken_s[1]


if __name__ == "__main__":
    run_end(bridge, action)
