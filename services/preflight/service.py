"""The preflight service: listens to everything for a second, checks it, and publishes what it found.

It does so every ten seconds while the vehicle stands, so that a takeoff never waits for it: the bridge refuses by the
newest report. In between, and in flight, it listens to status and clock only, and during a takeoff to what measures its
height.
"""

from collections.abc import Collection, Iterator
from typing import Any

from jezero.base.plugins import action_names
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Call, Health, Inbox, Output, Publish, Reply, Request, Spec, Subscribe
from jezero.schemas.estimate import GetParameters, SetParameters
from jezero.schemas.health import ServiceHealth
from jezero.schemas.preflight import PreflightReply, PreflightReport
from jezero.schemas.rows import Topic
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import (
    ALTIMETER,
    BARO,
    CHECK_PREFLIGHT,
    CLOCK,
    ESTIMATE_TAG,
    FENCE,
    GET_PARAMETERS,
    GNSS,
    IMU,
    MAG,
    PREFLIGHT,
    ROVER_ODOMETRY,
    STATUS,
    UWB,
    health_of,
)
from jezero.schemas.units import NS_PER_S
from jezero.services.preflight.charge_watch import ChargeWatch
from jezero.services.preflight.checks import (
    LANDING_CHAIN,
    check_autopilot,
    check_battery,
    check_clock,
    check_fence,
    check_services,
    check_storage,
)
from jezero.services.preflight.heading_watch import HeadingWatch
from jezero.services.preflight.height_watch import HeightWatch
from jezero.services.preflight.readings import Readings
from jezero.services.preflight.sensor_checks import (
    check_compass,
    check_gnss,
    check_noise,
    check_rover,
    check_sensors,
)
from jezero.services.table import SERVICES

CHECKS = (
    check_autopilot, check_services, check_clock, check_sensors, check_noise, check_gnss, check_compass, check_rover,
    check_battery, check_fence, check_storage,
)  # fmt: skip
SENSORS: tuple[Topic[Any], ...] = (IMU, GNSS, BARO, MAG, ALTIMETER, UWB, ROVER_ODOMETRY, ESTIMATE_TAG)
NAME = "preflight"
ELSEWHERE = frozenset({"rover", "ground"})
"""Profiles of services on other computers than the vehicle's, whose health no takeoff needs."""
ROUND_MIN_NS, ROUND_MAX_NS = 1_300_000_000, 4_000_000_000
"""Limits of a round. Every service publishes its health within the shorter one. A round with a failed check, or without
the health of a service, goes on up to the longer one: on a loaded computer a message may be late."""
PERIOD_NS, FAILED_PERIOD_NS = 10 * NS_PER_S, 2 * NS_PER_S
"""Time between two rounds; what has failed or was silent is checked again sooner."""
PARAMETERS = "parameters"


def checked_services() -> tuple[str, ...]:
    """Names of the services whose health is checked, besides the actions; every one publishes it once a second."""
    return tuple(
        row.name for row in SERVICES if not row.is_action and row.name != NAME and ELSEWHERE.isdisjoint(row.profiles)
    )


class Preflight:
    """Checks vehicle and stack before a takeoff.

    Args:
        services: names of the services whose health is checked; None stands for those of the table that run on the
            vehicle's computer, or simulate the vehicle.
        actions: names of all actions, whose servers' health is checked too; None stands for all that are installed.
        vehicle: the vehicle itself; None stands for the defaults.
        keys: what is wrong with the certificate of this computer, for people, or "".
    """

    def __init__(
        self,
        services: tuple[str, ...] | None = None,
        actions: Collection[str] | None = None,
        vehicle: VehicleConfig | None = None,
        keys: str = "",
    ) -> None:
        vehicle = vehicle or VehicleConfig()
        services = checked_services() if services is None else services
        actions = tuple(action_names() if actions is None else actions)
        self._health = {name: health_of(name) for name in (*services, *actions)}
        self._on_demand: tuple[Topic[Any], ...] = (*SENSORS, FENCE, *self._health.values())
        self.spec = Spec(
            name=NAME,
            inputs=(STATUS, CLOCK),
            on_demand=self._on_demand,
            outputs=(PREFLIGHT,),
            last_value=(PREFLIGHT,),
            serves=(CHECK_PREFLIGHT,),
            calls=(GET_PARAMETERS,),
            triggers=(CHECK_PREFLIGHT.name,),
            rate_hz=10.0,
            made_with={"services": services, "actions": actions, "vehicle": vehicle, "keys": keys},
        )
        self._vehicle, self._keys = vehicle, keys
        self._epoch_id: int | None = None
        self._requests: list[Request] = []
        """Requests for the next round."""
        self._waiting: list[Request] = []
        """Requests for the present round."""
        self._round_start_ns: int | None = None
        """Wall time of the start of the present round."""
        self._round_start_t_ns = 0
        """Vehicle time of the start of the present round."""
        self._due_ns = 0
        """Wall time of the next round of a vehicle that stands."""
        self._messages: dict[str, list[Any]] = {}
        self._parameters: SetParameters | None = None
        self._heard: frozenset[str] = frozenset()
        self._heard_services: frozenset[str] = frozenset()
        self._silent_services: frozenset[str] = frozenset()
        self._idle = False
        self._charge, self._heading, self._height = self._watches()
        self._alarmed = False
        """Whether a problem came up in flight since the last round."""

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Begin a round when it is due or wanted, collect, and end it."""
        self._requests += inbox.requests(CHECK_PREFLIGHT)
        listened = self._height.listens
        self._watch(inbox)
        if self._round_start_ns is None:
            if self._height.listens != listened:
                yield Subscribe(self._between_rounds)
            if self._requests or self._alarmed or (self._idle and inbox.wall_ns >= self._due_ns):
                yield from self._begin(t_ns, inbox.wall_ns)
            return
        self._collect(inbox)
        duration_ns = inbox.wall_ns - self._round_start_ns
        if duration_ns < ROUND_MIN_NS:
            return
        report = self._report(t_ns)
        missing = (self._heard_services | LANDING_CHAIN) - self._newest_health().keys()
        if duration_ns >= ROUND_MAX_NS or not (report.failed() or missing):
            yield from self._end(report, inbox.wall_ns)

    def _watch(self, inbox: Inbox) -> None:
        """Follow status and epoch.

        A vehicle that has just landed or become ready is checked at once, and in flight when its charge stands still,
        or its compass or one of its heights is found to be wrong.
        """
        status, clock = inbox.latest(STATUS), inbox.latest(CLOCK)
        if clock is not None and clock.epoch_id != self._epoch_id:
            self._epoch_id = clock.epoch_id
            self._heard = self._heard_services = self._silent_services = frozenset()
            self._round_start_ns, self._due_ns = None, 0
            self._requests, self._waiting = self._waiting + self._requests, []
            self._charge, self._heading, self._height = self._watches()
        before = self._problems
        for each in inbox.new(STATUS):
            self._charge.update(each)
            self._heading.update(each)
        if status is not None:
            self._height.update(status, inbox.new(ALTIMETER), inbox.new(BARO))
        self._alarmed |= any(now and not then for now, then in zip(self._problems, before, strict=True))
        idle = status is not None and status.code == StatusCode.IDLE and status.ready
        if idle and not self._idle:
            self._due_ns = 0
        self._idle = idle

    @property
    def _problems(self) -> tuple[str, ...]:
        """What the watches have found in flight."""
        return (self._charge.problem, self._heading.problem, self._height.problem)

    def _watches(self) -> tuple[ChargeWatch, HeadingWatch, HeightWatch]:
        return ChargeWatch(self._vehicle.battery), HeadingWatch(), HeightWatch(self._vehicle)

    def _begin(self, t_ns: int, wall_ns: int) -> Iterator[Output]:
        self._round_start_ns, self._round_start_t_ns = wall_ns, t_ns
        self._messages, self._parameters, self._alarmed = {}, None, False
        self._waiting, self._requests = self._requests, []
        yield Subscribe(self._on_demand)
        yield Call(GET_PARAMETERS, GetParameters(), PARAMETERS, timeout_s=1.0)

    @property
    def _between_rounds(self) -> tuple[Topic[Any], ...]:
        """Topics on demand that are needed while no round is made."""
        return (ALTIMETER, BARO) if self._height.listens else ()

    def _collect(self, inbox: Inbox) -> None:
        topics: tuple[Topic[Any], ...] = (STATUS, CLOCK, *self._on_demand)
        for topic in topics:
            if messages := inbox.new(topic):
                self._messages.setdefault(topic.name, []).extend(messages)
        for response in inbox.responses:
            if response.tag == PARAMETERS and response.payload is not None:
                self._parameters = response.payload.parameters

    def _report(self, t_ns: int) -> PreflightReport:
        """Check what has arrived in this round so far."""
        readings = Readings(
            t_ns=t_ns,
            duration_s=(t_ns - self._round_start_t_ns) / NS_PER_S,
            messages={name: tuple(messages) for name, messages in self._messages.items()},
            health=self._newest_health(),
            heard=self._heard,
            heard_services=self._heard_services,
            silent_services=self._silent_services,
            parameters=self._parameters,
            charge_problem=self._charge.problem,
            compass_problem=self._heading.problem,
            height_problem=self._height.problem,
            heading_by=self._vehicle.heading_by,
            keys_problem=self._keys,
        )
        checks = tuple(check(readings) for check in CHECKS)
        return PreflightReport(t_ns=t_ns, epoch_id=self._epoch_id or 0, checks=checks)

    def _newest_health(self) -> dict[str, ServiceHealth]:
        heard = {name: self._messages.get(topic.name) for name, topic in self._health.items()}
        return {name: messages[-1] for name, messages in heard.items() if messages}

    def _end(self, report: PreflightReport, wall_ns: int) -> Iterator[Output]:
        """Publish the report of a round, and reply to those who wait for it."""
        self._heard |= {topic.name for topic in SENSORS if topic.name in self._messages}
        health = self._newest_health().keys()
        self._silent_services = self._heard_services - health
        self._heard_services |= health
        self._round_start_ns, self._messages = None, {}
        failed = report.failed()
        self._due_ns = wall_ns + (FAILED_PERIOD_NS if failed or self._silent_services else PERIOD_NS)
        waiting, self._waiting = self._waiting, []
        yield Subscribe(self._between_rounds)
        yield Publish(PREFLIGHT, report)
        yield from (Reply(request.request_id, PreflightReply(report=report)) for request in waiting)
        names = ", ".join(check.name for check in failed)
        yield Health("ok", f"failed checks: {names}" if names else "no check has failed")
