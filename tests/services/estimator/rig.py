"""The estimator on the in-memory bus, with sensors that say what a given flight has them say, or step by step."""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np

from benchmarks.quality.estimator_flight import Arrival, Conditions, EstimatorFlight
from jezero.base.frames import Vec3, add, norm, scale, subtract
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Inbox, Output, Publish, Reply, Request, Spec
from jezero.schemas import topics
from jezero.schemas.estimate import Lease, Relative, RoverEstimate, TagEstimate
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.sensors import Altimeter, RoverOdometry, Uwb, UwbRange
from jezero.schemas.state import Clock, Odometry
from jezero.schemas.struct import Message, Payload
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.innovations import Innovation
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


MS = 1_000_000
REL_M: Vec3 = (0.8, -0.6, -4.0)
"""Beside the platform."""
POS_ROVER_NED_M: Vec3 = (9.0, -3.5, -0.5)
LEVEL: Vec3 = (0.0, 0.0, 0.0)


class Steps:
    """The estimator, step by step, with messages given by hand: a level vehicle with heading 0 near a rover that
    stands. Positions and ranges have noise of 1 mm, as a sensor that repeats itself counts as frozen.

    Args:
        rel_m: position of the vehicle minus that of the platform at time 0, in NED.
        vel_mps: velocity of the vehicle in NED.

    Attributes:
        relatives: all that was published.
        rovers: all that was published.
        health: the newest.
        innovations: those of the last step.
    """

    def __init__(
        self,
        config: EstimatorConfig | None = None,
        *,
        rel_m: Vec3 = REL_M,
        vel_mps: Vec3 = LEVEL,
        clock: bool = True,
    ) -> None:
        self._rel_m, self._vel_mps = rel_m, vel_mps
        self.vehicle = VehicleConfig()
        self.relatives: list[Relative] = []
        self.rovers: list[RoverEstimate] = []
        self.health = Health("ok", "")
        self.innovations: list[Innovation] = []
        self.estimator = Estimator(config or EstimatorConfig(), self.vehicle)
        self.estimator.observe_innovations(self.innovations.append)
        self._inbox = Mailbox(())
        self._rng = np.random.default_rng(1)
        if clock:
            self._inbox.add_message(topics.CLOCK.name, Clock(t_ns=0, epoch_id=1, wall_ns=0))

    @property
    def relative(self) -> Relative:
        """The newest."""
        return self.relatives[-1]

    def step(self, t_ms: int, *messages: Message) -> None:
        """One step at a time, with new messages."""
        rows: dict[type[Message], Topic[Any]] = {row.type: row for row in SENSORS}
        for message in messages:
            self._inbox.add_message(rows[type(message)].name, message)
        self._step(t_ms)

    def ask(self, t_ms: int, endpoint: Endpoint[Any, Any], payload: Payload) -> Any:
        """Reply to a request of one step."""
        self._inbox.add_request(endpoint.name, Request(1, "", payload))
        (reply,) = [output for output in self._step(t_ms) if isinstance(output, Reply)]
        return reply.payload

    def _step(self, t_ms: int) -> list[Output]:
        self.innovations.clear()
        outputs = list(self.estimator.step(t_ms * MS, self._inbox))
        self._inbox.clear()
        for output in outputs:
            if isinstance(output, Health):
                self.health = output
            elif isinstance(output, Publish) and isinstance(output.message, Relative):
                self.relatives.append(output.message)
            elif isinstance(output, Publish) and isinstance(output.message, RoverEstimate):
                self.rovers.append(output.message)
        return outputs

    def find_rover(self, until_ms: int, start_ms: int = 0, *, uwb: bool = True, tag: bool = True) -> None:
        """Step with odometry, tags and UWB every 20 ms; the last step is at `until_ms`."""
        for ms in range(start_ms, until_ms + 1, 20):
            aids: list[Message] = [self.tag(ms)] if tag else []
            if uwb:
                aids.append(self.uwb(ms))
            self.step(ms, self.odometry(ms), self.rover(ms), *aids)

    # -- messages ------------------------------------------------------------------------------------------

    def rel_m(self, t_ms: int) -> Vec3:
        """Position of the vehicle minus that of the platform, in NED."""
        return add(self._rel_m, scale(self._vel_mps, 1e-3 * t_ms))

    def odometry(self, t_ms: int, *, rates_rps: Vec3 = LEVEL, epoch_id: int = 1) -> Odometry:
        return Odometry(
            t_ns=t_ms * MS,
            epoch_id=epoch_id,
            pos_uav_ned_m=add(POS_ROVER_NED_M, self.rel_m(t_ms)),
            vel_uav_ned_mps=self._vel_mps,
            q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
            rates_uav_frd_rps=rates_rps,
        )

    def rover(self, t_ms: int, speed_mps: float = 0.0) -> RoverOdometry:
        return RoverOdometry(
            t_ns=t_ms * MS,
            pos_odom_m=(0.0, 0.0),
            yaw_rover_rad=0.0,
            speed_rover_body_mps=speed_mps,
            yaw_rate_rover_rps=0.0,
        )

    def altimeter(self, t_ms: int, range_m: float | None) -> Altimeter:
        return Altimeter(t_ns=t_ms * MS, range_m=range_m)

    def tag(self, t_ms: int, yaw_rad: float | None = None, std_yaw_rad: float | None = None) -> TagEstimate:
        x, y, z = subtract(self.rel_m(t_ms), (0.0, 0.0, self.vehicle.airframe.height_stand_m))
        return TagEstimate(
            t_ns=t_ms * MS,
            tag_ids=(0,),
            pos_uav_rel_rover_ned_m=(x + self._noise_m(), y + self._noise_m(), z + self._noise_m()),
            cov_pos_ned_m2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4),
            range_m=4.0,
            yaw_rover_rad=yaw_rad,
            std_yaw_rover_rad=std_yaw_rad,
            reprojection_px=0.1,
        )

    def uwb(self, t_ms: int, longer_m: float = 0.0) -> Uwb:
        """A round of which each range is 10 ms older than the next."""
        lever_m = subtract(self.vehicle.uwb.pos_tag_frd_m, (0.0, 0.0, self.vehicle.airframe.height_stand_m))
        places = self.vehicle.uwb.pos_anchors_rover_body_m
        times_ms = [t_ms - 10 * (len(places) - 1 - anchor) for anchor in range(len(places))]
        return Uwb(
            t_ns=t_ms * MS,
            ranges=tuple(
                UwbRange(
                    t_ns=time_ms * MS,
                    anchor=anchor,
                    pos_anchor_rover_body_m=place_m,
                    range_m=norm(subtract(add(self.rel_m(time_ms), lever_m), place_m)) + longer_m + self._noise_m(),
                )
                for anchor, (place_m, time_ms) in enumerate(zip(places, times_ms, strict=True))
            ),
        )

    def _noise_m(self) -> float:
        return float(self._rng.normal(0.0, 0.001))
