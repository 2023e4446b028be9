"""The whole stack in virtual time, with a record of its statuses and of the truth."""

from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from jezero.base.mavlink import MavlinkCodec, MavMessage
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.service import Inbox, Output, Send, Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, Rejected, Result
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal, TakeoffGoal
from jezero.schemas.rows import Action, Endpoint
from jezero.schemas.state import Status, StatusCode, Truth
from jezero.trials.stack import build_stack

_TYPES = {topic.name: topic.type for topic in (topics.STATUS, topics.TRUTH)}


class TamperedSimulator:
    """A simulator whose MAVLink messages are changed or dropped while `active` is set.

    Args:
        tamper: changes a message in place; False drops it.
    """

    def __init__(self, simulator: Service, tamper: Callable[[MavMessage], bool]) -> None:
        self._simulator = simulator
        self._tamper = tamper
        self._codec = MavlinkCodec(1, 25)
        self.spec = simulator.spec
        self.active = False

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for output in self._simulator.step(t_ns, inbox):
            yield self._tampered(output) if self.active and isinstance(output, Send) else output

    def _tampered(self, output: Send) -> Send:
        messages = MavlinkCodec(1, 25).parse(output.data)
        return Send(output.link, b"".join(self._codec.pack(m) for m in messages if self._tamper(m)))


class Flight:
    """A running stack.

    Args:
        make_bus: makes the bus with all services from the seed.

    Attributes:
        bus: the bus of the stack.
        codes: every status code so far, without repeats in a row.
        statuses: every status so far.
        truths: every truth so far.
    """

    def __init__(self, seed: int = 1, make_bus: Callable[[int], MemoryBus] = build_stack) -> None:
        self.bus = make_bus(seed)
        self.statuses: list[Status] = []
        self.truths: list[Truth] = []
        self.codes: list[StatusCode] = []
        self.bus.observe(self._observe)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        kind = _TYPES.get(topic)
        if kind is None:
            return
        message = msgspec.json.decode(data, type=kind)
        if isinstance(message, Truth):
            self.truths.append(message)
            return
        self.statuses.append(message)
        code = StatusCode(message.code)
        if not self.codes or self.codes[-1] is not code:
            self.codes.append(code)

    @property
    def status(self) -> Status:
        """The newest status."""
        return self.statuses[-1]

    @property
    def truth(self) -> Truth:
        """The newest truth."""
        return self.truths[-1]

    @classmethod
    def with_tampered_simulator(
        cls, tamper: Callable[[MavMessage], bool], seed: int = 5, **options: Any
    ) -> tuple["Flight", TamperedSimulator]:
        """A stack whose simulator's messages can be changed.

        Args:
            tamper: see `TamperedSimulator`.
            options: further arguments of `build_stack`.
        """
        simulators: list[TamperedSimulator] = []

        def wrap(simulator: Service) -> Service:
            simulators.append(TamperedSimulator(simulator, tamper))
            return simulators[0]

        return cls(seed, lambda seed: build_stack(seed, wrap_simulator=wrap, **options)), simulators[0]

    def wait(self, condition: Callable[[], bool], timeout_s: float, description: str) -> None:
        """Run until a condition holds.

        Args:
            description: of the condition, for the error.

        Raises:
            AssertionError: the condition did not hold in time.
        """
        if not self.bus.run_for(timeout_s, stop=condition):
            status = self.status
            raise AssertionError(f"{description}: not within {timeout_s} s; status {status.name}: {status.text}")

    def wait_ready(self) -> None:
        self.wait(lambda: bool(self.statuses) and self.status.ready, 30.0, "ready")

    def wait_code(self, code: StatusCode, timeout_s: float) -> None:
        self.wait(lambda: bool(self.codes) and self.codes[-1] is code, timeout_s, f"status {code.name}")

    def send(self, action: Action[Any], goal: Any) -> SentRequest:
        """Send a goal and run until it is accepted or rejected."""
        request = self.bus.send_request(action.endpoint, goal)
        self.wait(lambda: bool(request.replies) or request.ended, 2.0, f"a reply to {action.name}")
        return request

    def finish(self, request: SentRequest, timeout_s: float = 120.0) -> Result[Any]:
        """Run until a goal has its result.

        Args:
            request: result of `send`.
        """
        self.wait(lambda: request.ended, timeout_s, "the end of a goal")
        assert isinstance(request.replies[-1], Result), request.replies[-1]
        return request.replies[-1]

    def do(self, action: Action[Any], goal: Any) -> Result[Any]:
        """Send a goal and run until it has succeeded."""
        request = self.send(action, goal)
        assert isinstance(request.replies[0], Accepted), request.replies[0]
        result = self.finish(request)
        assert result.outcome == "succeeded", result.reason
        return result

    def refusal(self, action: Action[Any], goal: Any) -> str:
        """Send a goal that is rejected; returns the reason."""
        request = self.send(action, goal)
        assert isinstance(request.replies[0], Rejected), request.replies[0]
        return request.replies[0].reason

    def take_off(self, altitude_m: float = 2.0) -> None:
        self.wait_ready()
        self.do(topics.TAKEOFF, TakeoffGoal(altitude_m=altitude_m))

    def request(self, endpoint: Endpoint[Any, Any], payload: Any, timeout_s: float = 15.0) -> Any:
        """Send a request and run until it has ended; returns the first reply."""
        request = self.bus.send_request(endpoint, payload)
        self.wait(lambda: request.ended, timeout_s, f"a reply on {endpoint.name}")
        return request.replies[0]


def go_to(north_m: float, east_m: float, down_m: float, **fields: Any) -> GoToGoal:
    return GoToGoal(target_ned_m=(north_m, east_m, down_m), **fields)


def land_at(north_m: float, east_m: float) -> LandOnSpotGoal:
    return LandOnSpotGoal(landing_spot_ned_m=(north_m, east_m, 0.0), use_uwb=False, use_tag=False)
