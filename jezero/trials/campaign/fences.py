"""Fences drawn at random, the requests that set them, and action servers that know of no fence."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from math import cos, hypot, sin, tau
from random import Random
from typing import Any

from msgspec.structs import replace

from jezero.plugins import action_names
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Inbox, Output, Service
from jezero.schemas import topics
from jezero.schemas.fence import Fence, FenceReply, SetFence, Zone
from jezero.schemas.units import NS_PER_S

FENCED_PROBABILITY = 1.0 / 3.0
"""Share of the seeds that fly with fences."""
UNAWARE_PROBABILITY = 0.5
"""Share of those in which some action servers know of no fence, so that the bridge alone holds the vehicle."""
START_CLEARANCE_M = 1.5
"""Least distance of a zone to stay out of from the place where the vehicle first stands."""
CLIENT = "alice"


class FenceSetter:
    """Sends the requests for fences of one mission.

    Args:
        bus: the bus of the stack.
        rng: draws everything.
        last_s: time of the latest request.
        on_event: called with a sentence for each request.

    Attributes:
        unaware: names of the action servers that know of no fence.
    """

    def __init__(self, bus: MemoryBus, rng: Random, last_s: float, on_event: Callable[[str], None]) -> None:
        self._bus = bus
        self._on_event = on_event
        self._requests: list[SentRequest] = []
        self.unaware: frozenset[str] = frozenset()
        self._drawn: list[tuple[float, Fence | None]] = []
        """Time of each request, after the vehicle was first ready, and its fence."""
        if rng.random() >= FENCED_PROBABILITY:
            return
        if rng.random() < UNAWARE_PROBABILITY:
            self.unaware = frozenset(rng.sample(sorted(action_names()), rng.randint(1, 3)))
        self._drawn.append((0.0, draw_fence(rng)))
        for _ in range(rng.randint(0, 2)):
            fence = draw_fence(rng) if rng.random() < 0.8 else None
            self._drawn.append((rng.uniform(0.0, last_s), fence))

    def start(self) -> None:
        """Send the requests from now on."""
        for after_s, fence in self._drawn:
            self._bus.at(self._bus.t_ns + int(after_s * NS_PER_S), "", partial(self._send, fence))

    def _send(self, fence: Fence | None) -> None:
        self._on_event(f"{CLIENT} requests {'no fence' if fence is None else fence}")
        self._requests.append(self._bus.send_request(topics.SET_FENCE, SetFence(fence=fence), CLIENT))

    @property
    def accepted(self) -> int:
        """Number of requests that were accepted."""
        replies = [reply for request in self._requests for reply in request.replies]
        return sum(isinstance(reply, FenceReply) and reply.accepted for reply in replies)


def draw_fence(rng: Random) -> Fence:
    """Draw a fence around the place where the vehicle first stands, near enough for goals to meet it."""
    center_m = (rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0))
    field = _draw_zone(rng, "field", center_m, (5.0, 13.0))
    zones = [_draw_crater(rng, number) for number in range(rng.choice((0, 0, 1, 1, 2)))]
    return Fence(
        name="mars",
        keep_in=field if rng.random() < 0.9 else None,
        keep_out=tuple(zones),
        ceiling_m=rng.uniform(3.5, 8.0) if rng.random() < 0.5 else None,
        floor_over_ground_m=rng.uniform(0.5, 1.5) if rng.random() < 0.3 else 0.0,
    )


def _draw_crater(rng: Random, number: int) -> Zone:
    while True:
        center_m = (rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0))
        radius_max_m = rng.uniform(1.0, 3.0)
        if hypot(*center_m) > radius_max_m + START_CLEARANCE_M:
            return _draw_zone(rng, f"crater {number}", center_m, (0.7, radius_max_m))


def _draw_zone(rng: Random, name: str, center_m: Sequence[float], radii_m: tuple[float, float]) -> Zone:
    """Draw a polygon whose corners have increasing bearings from its centre, so that its edges don't cross."""
    count = rng.randint(4, 9)
    corners = []
    for index in range(count):
        bearing_rad, radius_m = tau * (index + rng.uniform(0.0, 0.6)) / count, rng.uniform(*radii_m)
        corners.append((center_m[0] + radius_m * cos(bearing_rad), center_m[1] + radius_m * sin(bearing_rad)))
    return Zone(name=name, corners_ned_m=tuple(corners))


class UnawareServer:
    """Service that runs an action server and hides the fence from it, as one would be that is older than fences.

    Args:
        server: the action server.
    """

    def __init__(self, server: Service) -> None:
        self.spec = server.spec
        self._server = server

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """See `Service`."""
        hidden: Any = _WithoutFence(inbox)
        yield from self._server.step(t_ns, hidden)


class _WithoutFence:
    """An inbox whose statuses name no fence."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox

    def latest(self, topic: Any) -> Any:
        message: Any = self._inbox.latest(topic)
        return replace(message, fence_id="") if topic is topics.STATUS and message is not None else message

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inbox, name)
