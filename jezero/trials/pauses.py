"""Flights whose goals are paused and resumed at random instants, to compare with the same flights without pauses."""

import zlib
from collections.abc import Sequence
from itertools import pairwise
from math import dist
from random import Random
from typing import Any

import msgspec

from jezero.base.codec import decode
from jezero.base.frames import Vec3, horizontal
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas import topics
from jezero.schemas.actions import Pause, Rejected, Result, Resume
from jezero.schemas.commands import Setpoint
from jezero.schemas.goals import AreaCoverageGoal, GetImagesGoal, GoToGoal, ImagesResult, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.rows import Action, Endpoint
from jezero.schemas.state import Status, Truth
from jezero.schemas.struct import Payload
from jezero.schemas.units import NS_PER_S
from jezero.trials.campaign.models import MODELS
from jezero.trials.platform import offset_m

READY_TIMEOUT_S, GOAL_TIMEOUT_S, REPLY_TIMEOUT_S = 60.0, 400.0, 25.0
PAUSE_MAX_S = 3.0
ACCELERATION_MPS2 = 2.0
"""Greatest acceleration of the setpoints: twice that of a straight path, as a pause may brake while the path brakes."""
GAP_MAX_S = 0.1

_WORLD_GOALS: tuple[tuple[Action[Any], Payload], ...] = (
    (topics.GO_TO, GoToGoal(target_ned_m=(6.0, -4.0, -5.0), yaw_rad=1.0)),
    (topics.GET_IMAGES, GetImagesGoal(center_ned_m=(0.0, 0.0, -4.0), radius_m=3.0, num_images=8)),
    (
        topics.AREA_COVERAGE,
        AreaCoverageGoal(polygon_ned_m=((-4.0, -3.0), (4.0, -3.0), (4.0, 3.0)), z_ned_m=-5.0, resolution_m=1.5),
    ),
)
GOALS: dict[str, tuple[tuple[Action[Any], Payload], ...]] = {
    "physics": (
        (topics.TAKEOFF, TakeoffGoal(altitude_m=3.0)),
        (topics.GO_TO, GoToGoal(target_ned_m=(1.0, 1.0, -4.0), frame="rover")),
        *_WORLD_GOALS,
        (topics.LAND_ON_SPOT, LandOnSpotGoal()),
    ),
    "point-mass": (
        (topics.TAKEOFF, TakeoffGoal(altitude_m=3.0)),
        *_WORLD_GOALS,
        (topics.LAND_ON_SPOT, LandOnSpotGoal(landing_spot_ned_m=(1.0, 2.0, 0.0), use_uwb=False, use_tag=False)),
    ),
}
"""Goals of one flight by model; with the point mass nothing estimates the rover."""


class PausedGoal(msgspec.Struct, kw_only=True):
    """One goal of a flight.

    Attributes:
        action: its action.
        outcome: its outcome, or why there is none.
        duration_s: from its request to its result.
        pauses: number of pauses that were accepted.
        refused: reasons of those that were not.
        pictures_ned_m: position of the vehicle at each of its pictures.
        step_mps: greatest step of the velocity setpoint, beyond what the acceleration allows.
    """

    action: str
    outcome: str = ""
    duration_s: float = 0.0
    pauses: int = 0
    refused: list[str] = msgspec.field(default_factory=list)
    pictures_ned_m: dict[int, Vec3] = msgspec.field(default_factory=dict)
    step_mps: float = 0.0


class PausedFlight(msgspec.Struct, kw_only=True):
    """All goals of one flight.

    Attributes:
        seed: of the flight.
        goals: its goals, in order.
        touchdown_error_m: horizontal distance from the middle of the platform at the end.
    """

    seed: int
    goals: list[PausedGoal] = msgspec.field(default_factory=list)
    touchdown_error_m: float = 0.0


class ObservedStack:
    """A stack with one model of the vehicle, the newest status and truth, and all setpoints."""

    def __init__(self, seed: int, model: str) -> None:
        self.bus: MemoryBus = MODELS[model].make_bus(seed)
        self.status: Status | None = None
        self.truth: Truth | None = None
        self.setpoints: list[Setpoint] = []
        self.bus.observe(self._observe)
        for name, make in MODELS[model].make_service_makers(seed).items():
            self.bus.add(make(zlib.crc32(f"{seed}/{name}".encode())))

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.STATUS.name:
            self.status = decode(Status, data)
        elif topic == topics.TRUTH.name:
            self.truth = decode(Truth, data)
        elif topic == topics.SETPOINT.name:
            self.setpoints.append(decode(Setpoint, data))

    def wait_ready(self) -> None:
        """Wait until a takeoff would be accepted, and all action servers know it."""
        self.bus.run_for(READY_TIMEOUT_S, lambda: self.status is not None and self.status.ready)
        self.bus.run_for(1.0)

    def request(self, endpoint: Endpoint[Any, Any], payload: Payload) -> Any:
        """The reply to a request."""
        sent = self.bus.send_request(endpoint, payload)
        self.bus.run_for(REPLY_TIMEOUT_S, lambda: sent.ended)
        return sent.replies[0]


def fly_with_pauses(
    seed: int, model: str = "physics", durations_s: Sequence[float] = (), pauses: int = 10
) -> PausedFlight:
    """Fly all goals, each with some pauses.

    Args:
        durations_s: of each goal without pauses, over which the pauses are spread; none for a flight without pauses.
        pauses: number of pauses of each goal.
    """
    flight, report = ObservedStack(seed, model), PausedFlight(seed=seed)
    rng = Random(zlib.crc32(f"pauses/{seed}".encode()))
    flight.wait_ready()
    goals = GOALS[model][: len(durations_s) or None]
    for number, (action, goal) in enumerate(goals):
        flown = PausedGoal(action=action.name)
        report.goals.append(flown)
        instants_s = sorted(rng.uniform(0.0, durations_s[number]) for _ in range(pauses)) if durations_s else []
        _fly(flight, action, msgspec.structs.replace(goal, goal_id=f"g{number}"), instants_s, rng, flown)
        if flown.outcome != "succeeded":
            break
        flight.bus.run_for(1.0)
    report.touchdown_error_m = 0.0 if flight.truth is None else horizontal(offset_m(flight.truth))
    return report


def _fly(
    flight: ObservedStack,
    action: Action[Any],
    goal: Any,
    instants_s: Sequence[float],
    rng: Random,
    flown: PausedGoal,
) -> None:
    """Fly one goal to its end.

    Args:
        instants_s: times of the pauses since the goal's begin, in the goal's own time.
    """
    bus, begin_ns, first = flight.bus, flight.bus.t_ns, len(flight.setpoints)
    query = bus.send_request(action.endpoint, goal)
    at_s = 0.0
    for instant_s in instants_s:
        bus.run_for(instant_s - at_s, lambda: query.ended)
        at_s = instant_s
        if query.ended:
            break
        reply = flight.request(action.pause, Pause(goal_id=goal.goal_id))
        if not reply.paused:
            flown.refused.append(reply.reason)
            continue
        flown.pauses += 1
        bus.run_for(rng.uniform(0.0, PAUSE_MAX_S), lambda: query.ended)
        if not query.ended:
            flight.request(action.resume, Resume(goal_id=goal.goal_id))
    bus.run_for(GOAL_TIMEOUT_S, lambda: query.ended)
    flown.duration_s = (bus.t_ns - begin_ns) / NS_PER_S
    flown.outcome = _outcome(query, flown)
    flown.step_mps = _step_mps(flight.setpoints[first:])


def _outcome(query: SentRequest, flown: PausedGoal) -> str:
    last = query.replies[-1] if query.replies else None
    if isinstance(last, Rejected):
        return f"refused: {last.reason}"
    if not isinstance(last, Result):
        return "no result"
    if isinstance(last.result, ImagesResult):
        flown.pictures_ned_m = {image.index: image.pos_uav_ned_m for image in last.result.images}
    return "succeeded" if last.outcome == "succeeded" else f"{last.outcome}: {last.reason}"


def _step_mps(setpoints: Sequence[Setpoint]) -> float:
    """Greatest step of the velocity setpoint, beyond what the acceleration allows."""
    greatest_mps = 0.0
    for one, other in pairwise(setpoints):
        gap_s = (other.t_ns - one.t_ns) / NS_PER_S
        if gap_s <= GAP_MAX_S and one.vel_ned_mps is not None and other.vel_ned_mps is not None:
            greatest_mps = max(greatest_mps, dist(one.vel_ned_mps, other.vel_ned_mps) - ACCELERATION_MPS2 * gap_s)
    return greatest_mps
