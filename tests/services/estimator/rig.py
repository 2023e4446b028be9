"""The estimator on the in-memory bus, with sensors that say what a given flight has them say."""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any

import msgspec

from benchmarks.quality.estimator_flight import Arrival, Conditions, EstimatorFlight
from jezero.base.frames import Vec3, norm, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.estimate import Lease, Relative, RoverEstimate
from jezero.schemas.rows import Endpoint
from jezero.schemas.struct import Payload
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.service import Estimator

Tamper = Callable[[Arrival], Iterable[Arrival]]
SENSORS = (topics.CLOCK, topics.ODOMETRY, topics.UWB, topics.ALTIMETER, topics.ROVER_ODOMETRY, topics.ESTIMATE_TAG)


@lru_cache(maxsize=4)
def _arrivals(seed: int, conditions: Conditions) -> tuple[Arrival, ...]:
    return tuple(EstimatorFlight(seed, conditions).arrivals())


class Replay:
    """Publishes a flight's messages when they arrive."""

    spec = Spec(name="replay", outputs=SENSORS, rate_hz=100.0)

    def __init__(self, arrivals: Iterator[Arrival]) -> None:
        self._arrivals = arrivals
        self._next: Arrival | None = next(arrivals, None)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        while self._next is not None and self._next[0] <= t_ns:
            yield Publish(self._next[1], self._next[2])
            self._next = next(self._arrivals, None)


class Rig:
    """A flight and the estimator that follows it.

    Args:
        tamper: makes of each message what arrives instead.
    """

    def __init__(
        self,
        conditions: Conditions | None = None,
        seed: int = 1,
        config: EstimatorConfig | None = None,
        tamper: Tamper = lambda arrival: (arrival,),
    ) -> None:
        self.flight = EstimatorFlight(seed, conditions or Conditions())
        self.config, self.vehicle = config or EstimatorConfig(), VehicleConfig()
        self.relatives: list[Relative] = []
        self.rovers: list[RoverEstimate] = []
        self.bus = MemoryBus(seed)
        self.bus.observe(self._observe)
        self.bus.add(Estimator(self.config, self.vehicle))
        arrivals = (after for before in _arrivals(seed, self.flight.conditions) for after in tamper(before))
        self.bus.add(Replay(iter(sorted(arrivals, key=lambda arrival: arrival[0]))))

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.RELATIVE.name:
            self.relatives.append(msgspec.json.decode(data, type=Relative))
        elif topic == topics.ROVER_ESTIMATE.name:
            self.rovers.append(msgspec.json.decode(data, type=RoverEstimate))

    @property
    def relative(self) -> Relative:
        """The newest."""
        return self.relatives[-1]

    def until(self, t_s: float) -> Relative:
        """Run until a time of the flight."""
        self.bus.run_until(int(t_s * NS_PER_S))
        return self.relative

    def error_m(self, relative: Relative | None = None) -> float:
        """Distance of a result, the newest unless given, from the truth of its time."""
        relative = relative or self.relative
        truth = self.flight.truth(relative.t_ns / NS_PER_S)
        return norm(subtract(relative.pos_uav_rel_rover_ned_m, truth.pos_rel_m))

    def restart_estimator(self) -> None:
        """A new process of it."""
        self.bus.add(Estimator(self.config, self.vehicle))

    def ask(self, endpoint: Endpoint[Any, Any], payload: Payload) -> Any:
        """A question's answer; takes some milliseconds of the flight."""
        answers = self.bus.send_request(endpoint, payload)
        assert self.bus.run_for(1.0, stop=lambda: answers.ended), f"no answer on {endpoint.name}"
        return answers.replies[0]

    def lease(self, goal_id: str = "land-1", *, uwb: bool, tag: bool, pos_ned_m: Vec3 | None = None) -> Any:
        """Begin or renew a lease."""
        return self.ask(topics.LEASE, Lease(goal_id=goal_id, use_uwb=uwb, use_tag=tag, pos_rover_ned_m=pos_ned_m))
