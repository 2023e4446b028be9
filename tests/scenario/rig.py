"""The whole stack in virtual time, with what a test wants to see of it."""

from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from jezero.mavlink import MavlinkCodec, MavMessage
from jezero.runtime.memory_bus import Answers, MemoryBus
from jezero.runtime.service import Inbox, Output, Send, Service
from jezero.schemas import topics
from jezero.schemas.actions import Accepted, GoToGoal, LandOnSpotGoal, Rejected, Result, TakeoffGoal
from jezero.schemas.state import Status, StatusCode, Truth
from jezero.trials.stack import build_stack

_TYPES = {topic.name: topic.type for topic in (topics.STATUS, topics.TRUTH)}


class Between:
    """A simulator whose MAVLink goes through a hand that changes or drops messages once `broken` is set."""

    def __init__(self, simulator: Service, change: Callable[[MavMessage], bool]) -> None:
        self._simulator = simulator
        self._change = change
        self._codec = MavlinkCodec(1, 25)
        self.spec = simulator.spec
        self.broken = False

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for output in self._simulator.step(t_ns, inbox):
            yield self._changed(output) if self.broken and isinstance(output, Send) else output

    def _changed(self, output: Send) -> Send:
        messages = MavlinkCodec(1, 25).parse(output.data)
        return Send(output.link, b"".join(self._codec.pack(m) for m in messages if self._change(m)))


class Flight:
    """A running stack.

    Attributes:
        codes: every status code so far, without repeats in a row.
        statuses, truths: everything published.
    """

    def __init__(self, seed: int = 1, prepare: Callable[[int], MemoryBus] = build_stack) -> None:
        self.bus = prepare(seed)
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
        """The newest."""
        return self.statuses[-1]

    @property
    def truth(self) -> Truth:
        """The newest."""
        return self.truths[-1]

    @classmethod
    def broken(cls, change: Callable[[MavMessage], bool], seed: int = 5, **stack: Any) -> tuple["Flight", Between]:
        """A stack whose simulator can be broken.

        Args:
            change: changes a message of the simulator's in place; False drops it.
            stack: what else `build_stack` shall know.
        """
        hands: list[Between] = []

        def wrap(simulator: Service) -> Service:
            hands.append(Between(simulator, change))
            return hands[0]

        return cls(seed, lambda seed: build_stack(seed, wrap_simulator=wrap, **stack)), hands[0]

    def wait(self, condition: Callable[[], bool], within_s: float, what: str) -> None:
        """Run until it holds.

        Raises:
            AssertionError: it didn't within the time.
        """
        if not self.bus.run_for(within_s, stop=condition):
            raise AssertionError(f"{what}: not within {within_s} s; status {self.status.name}: {self.status.text}")

    def wait_ready(self) -> None:
        self.wait(lambda: bool(self.statuses) and self.status.ready, 30.0, "ready")

    def wait_code(self, code: StatusCode, within_s: float) -> None:
        self.wait(lambda: bool(self.codes) and self.codes[-1] is code, within_s, f"status {code.name}")

    def send(self, action: topics.Action[Any], goal: Any) -> Answers:
        """Send a goal and run until it is accepted or rejected."""
        answers = self.bus.ask(action.endpoint, goal)
        self.wait(lambda: bool(answers.replies) or answers.ended, 2.0, f"an answer to {action.name}")
        return answers

    def finish(self, answers: Answers, within_s: float = 120.0) -> Result[Any]:
        """Run until a goal has its result."""
        self.wait(lambda: answers.ended, within_s, "the end of a goal")
        assert isinstance(answers.replies[-1], Result), answers.replies[-1]
        return answers.replies[-1]

    def do(self, action: topics.Action[Any], goal: Any) -> Result[Any]:
        """A goal from start to success."""
        answers = self.send(action, goal)
        assert isinstance(answers.replies[0], Accepted), answers.replies[0]
        result = self.finish(answers)
        assert result.outcome == "succeeded", result.reason
        return result

    def refusal(self, action: topics.Action[Any], goal: Any) -> str:
        """The reason why a goal is rejected."""
        answers = self.send(action, goal)
        assert isinstance(answers.replies[0], Rejected), answers.replies[0]
        return answers.replies[0].reason

    def take_off(self, altitude_m: float = 2.0) -> None:
        self.wait_ready()
        self.do(topics.TAKEOFF, TakeoffGoal(altitude_m=altitude_m))

    def ask(self, endpoint: topics.Endpoint[Any, Any], payload: Any, within_s: float = 15.0) -> Any:
        """A question with one answer."""
        answers = self.bus.ask(endpoint, payload)
        self.wait(lambda: answers.ended, within_s, f"an answer on {endpoint.name}")
        return answers.replies[0]


def go_to(north_m: float, east_m: float, down_m: float, **fields: Any) -> GoToGoal:
    return GoToGoal(target_ned_m=(north_m, east_m, down_m), **fields)


def land_at(north_m: float, east_m: float) -> LandOnSpotGoal:
    return LandOnSpotGoal(landing_spot_ned_m=(north_m, east_m, 0.0), use_uwb=False, use_tag=False)
