"""What the preflight checks judge: messages of one second, and what was heard before."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from jezero.base.vehicle_config import HeadingSource
from jezero.schemas.estimate import SetParameters
from jezero.schemas.health import ServiceHealth
from jezero.schemas.rows import Topic
from jezero.schemas.state import Status
from jezero.schemas.struct import Message
from jezero.schemas.topics import STATUS
from jezero.schemas.units import NS_PER_S

M = TypeVar("M", bound=Message)


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Messages of one round of checks.

    Attributes:
        t_ns: vehicle time at the end of the round.
        duration_s: vehicle time that the round took.
        messages: messages of the round by the topic's name, oldest first.
        health: newest health of each service in this round, by the service's name.
        heard: names of the topics that were heard in an earlier round.
        heard_services: names of the services that were heard in an earlier round.
        silent_services: names of the services that were silent in the round before.
        parameters: parameters of the estimator; None when it does not reply.
        charge_problem: what is wrong with the reported charge, see `ChargeWatch`, or "".
        compass_problem: what is wrong with the compass, see `HeadingWatch`, or "".
        height_problem: which measured height is wrong, see `HeightWatch`, or "".
        heading_by: what measures the vehicle's heading, see `VehicleConfig`.
        keys_problem: what is wrong with the certificate of this computer, or "".
    """

    t_ns: int
    duration_s: float
    messages: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    health: Mapping[str, ServiceHealth] = field(default_factory=dict)
    heard: frozenset[str] = frozenset()
    heard_services: frozenset[str] = frozenset()
    silent_services: frozenset[str] = frozenset()
    parameters: SetParameters | None = None
    charge_problem: str = ""
    compass_problem: str = ""
    height_problem: str = ""
    heading_by: HeadingSource = "magnetometer"
    keys_problem: str = ""

    def all(self, topic: Topic[M]) -> tuple[M, ...]:
        """Messages of a topic, oldest first."""
        return self.messages.get(topic.name, ())

    def latest(self, topic: Topic[M]) -> M | None:
        """Newest message of a topic; None without one."""
        found = self.all(topic)
        return found[-1] if found else None

    @property
    def status(self) -> Status | None:
        """Newest status of the vehicle."""
        return self.latest(STATUS)

    def age_s(self, topic: Topic[M]) -> float | None:
        """Age of the newest message of a topic; None without one."""
        message = self.latest(topic)
        return None if message is None else (self.t_ns - message.t_ns) / NS_PER_S
