"""A hostile computer in the team's network: `python hostile.py ROUTER VEHICLE` tries all it can until it is ended.

ROUTER is Zenoh's endpoint, with the files of a bundle. It prints the name of each attempt, again and again. What it
sends is what a member with the right to it would send: requests of the contract for the goal in charge, and messages
of the vehicle that it has heard, later and with other numbers.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import zenoh

from jezero.base.codec import encode
from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, Modify, Pause
from jezero.schemas.commands import Abort, Acquire, Hover, Kill, RoverCommand
from jezero.schemas.estimate import SetParameters
from jezero.schemas.fence import SetFence
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.mission import MissionCommand
from jezero.schemas.rows import Endpoint
from jezero.schemas.struct import Payload

TIMEOUT_S = 5.0
PERIOD_S = 0.01
Attempt = tuple[str, Callable[[], Any]]


class Hostile:
    """One session that tries to fly a vehicle without the right to it."""

    def __init__(self, session: zenoh.Session, vehicle: str) -> None:
        self._session, self._vehicle = session, vehicle
        self._heard: dict[str, bytes] = {}
        """The latest message of each topic, by its whole key."""
        self._kept: list[Any] = [
            session.declare_subscriber(self._key("**"), self._on_sample, allowed_origin=zenoh.Locality.REMOTE)
        ]

    def _key(self, name: str) -> str:
        return topics.key(self._vehicle, name)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self._heard[str(sample.key_expr)] = sample.payload.to_bytes()

    def attempts(self) -> Iterator[Attempt]:
        """Name and function of each attempt; the declarations stay."""
        yield from self._declarations()
        while True:
            yield from self._requests()
            yield from self._messages()

    def _declarations(self) -> Iterator[Attempt]:
        for service in ("estimator", "vehicle_bridge"):
            yield f"be {service}", partial(self._be, topics.liveliness_key(self._vehicle, "service", service))
        for endpoint in (topics.HOVER, topics.ACQUIRE, topics.TAKEOFF.endpoint, topics.RESULT):
            yield f"serve {endpoint.name}", partial(self._serve, endpoint)

    def _be(self, token: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(token))

    def _serve(self, endpoint: Endpoint[Any, Any]) -> None:
        def refuse(query: zenoh.Query) -> None:
            with query:
                query.reply(query.key_expr, encode(endpoint.refuse("no")))

        self._kept.append(self._session.declare_queryable(self._key(endpoint.name), refuse, complete=True))

    def _requests(self) -> Iterator[Attempt]:
        status = json.loads(self._heard.get(self._key(topics.STATUS.name), b"{}"))
        goal_id, action = status.get("goal_id") or "none", topics.ACTIONS.get(status.get("action", ""), topics.GO_TO)
        requests: list[tuple[Endpoint[Any, Any], Payload]] = [
            (topics.ACQUIRE, Acquire(goal_id="mine", action="go_to")),
            (topics.HOVER, Hover()),
            (topics.ABORT, Abort()),
            (topics.KILL, Kill(confirm=True, vehicle=self._vehicle)),
            (topics.SET_PARAMETERS, SetParameters(use_uwb=False, use_tag=False)),
            (topics.SET_FENCE, SetFence()),
            (topics.COMMAND_MISSION, MissionCommand(command="stop")),
            (topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=30.0)),
            (topics.GO_TO.endpoint, GoToGoal(target_ned_m=(20.0, 20.0, -9.0))),
            (topics.LAND_ON_SPOT.endpoint, LandOnSpotGoal(landing_spot_ned_m=(9.0, 9.0, 0.0))),
            (action.cancel, Cancel(goal_id=goal_id)),
            (action.pause, Pause(goal_id=goal_id)),
            (action.modify, Modify(goal_id=goal_id, fields={"speed_mps": 5.0})),
        ]
        for endpoint, request in requests:
            yield f"ask {endpoint.name}", partial(self._ask, endpoint, request)

    def _ask(self, endpoint: Endpoint[Any, Any], request: Payload) -> None:
        self._session.get(self._key(endpoint.name), lambda _reply: None, payload=encode(request), timeout=0.5)

    def _messages(self) -> Iterator[Attempt]:
        command = encode(RoverCommand(t_ns=0, speed_rover_body_mps=1.0, yaw_rate_rover_rps=0.5))
        yield "put rover/command", partial(self._session.put, self._key(topics.ROVER_COMMAND.name), command)
        for key, message in list(self._heard.items()):
            other = message.replace(b"true", b"false").replace(b":1", b":9").replace(b"-", b"")
            yield f"replay {key}", partial(self._session.put, key, message)
            yield f"put {key}", partial(self._session.put, key, other)
        for name in (self._key("**"), self._key(topics.STATUS.name)):
            yield f"delete {name}", partial(self._session.delete, name)
            yield f"put 10 MB on {name}", partial(self._session.put, name, bytes(10_000_000))


def main(router: str, vehicle: str) -> None:
    with zenoh.open(client_config(router, TIMEOUT_S)) as session:
        hostile = Hostile(session, vehicle)
        for number, (name, attempt) in enumerate(hostile.attempts()):
            attempt()
            print(name, flush=True)
            time.sleep(PERIOD_S if number > 10 else 0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
