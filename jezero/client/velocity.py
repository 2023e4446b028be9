"""A flight by velocity: a goal whose client steers it.

```python
with uav.fly_velocity() as stick:
    stick.send(forward_mps=1.0, for_s=3.0)
    while pressed():
        stick.send(forward_mps=..., right_mps=..., up_mps=..., yaw_rate_rps=...)  # five times a second or more
```
"""

import time
from contextlib import suppress
from math import inf
from types import TracebackType
from typing import Any, Self

import msgspec

from jezero.base.mistakes import mistake
from jezero.client.errors import JezeroError, Refused, TimedOut
from jezero.client.goal import Goal
from jezero.schemas.commands import VelocityCommand
from jezero.schemas.goals import VelocityFeedback, VelocityResult
from jezero.schemas.topics import VELOCITY_COMMAND
from jezero.schemas.units import NS_PER_S

FEEDBACK_TIMEOUT_S = 1.0
"""Longest wait for feedback, which comes ten times a second and has the vehicle time for the commands."""
STOP_TIMEOUT_S = 20.0
"""Longest wait for the vehicle to come to rest after the last command."""


class VelocityGoal(Goal[VelocityFeedback, VelocityResult]):
    """A running flight by velocity. At the end of a `with` block the vehicle comes to rest, and the goal succeeds.

    Attributes:
        newest: the newest feedback; None before.
    """

    newest: VelocityFeedback | None = None
    _heard_s = -inf
    """Monotonic time of the newest feedback."""

    def send(
        self,
        forward_mps: float = 0.0,
        right_mps: float = 0.0,
        up_mps: float = 0.0,
        yaw_rate_rps: float = 0.0,
        *,
        for_s: float | None = None,
    ) -> None:
        """Command a velocity, relative to the vehicle's heading. The vehicle follows it for half a second.

        The vehicle's limits hold: `newest.limited_by` says what keeps it from flying as commanded.

        Args:
            forward_mps: along the heading; negative is backwards.
            right_mps: to the right; negative is to the left.
            up_mps: upwards; negative is downwards.
            yaw_rate_rps: clockwise as seen from above.
            for_s: repeat the command for this vehicle time, and return then; None returns at once.

        Raises:
            ValueError: a number is NaN, or outside of its range.
            Aborted, Canceled: the goal has ended; the text is the reason.
            Refused: the goal has succeeded before.
            TimedOut: no feedback comes.
            Unreachable: the connection is lost.
        """
        command = self._command(forward_mps, right_mps, up_mps, yaw_rate_rps)
        self._drain()
        if self.newest is None:
            self.next_feedback(FEEDBACK_TIMEOUT_S)
        start_ns = self._publish(command)
        while for_s is not None and self._publish(command) - start_ns < for_s * NS_PER_S:
            self.next_feedback(FEEDBACK_TIMEOUT_S)

    def finish(self) -> VelocityResult:
        """Let the vehicle come to rest, and wait for the goal's result; raises the errors of `Goal.result`."""
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        while not self._ended and time.monotonic() < deadline_s:
            self._publish_last()
            with suppress(TimedOut):
                self.next_feedback(FEEDBACK_TIMEOUT_S)
        if not self._ended:
            self.cancel()
        return self.result(STOP_TIMEOUT_S)

    def try_finish(self) -> bool:
        """Ask for the end, and return at once; to be repeated until it returns True. Raises the errors of `finish`."""
        self._drain()
        if self._ended:
            self.result()
            return True
        self._publish_last()
        return False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if error is None:
            self.finish()
        else:
            with suppress(JezeroError):  # the block's own error says more
                self.finish()

    def _command(self, forward_mps: float, right_mps: float, up_mps: float, yaw_rate_rps: float) -> VelocityCommand:
        """A command without a time stamp; raises ValueError where a number is out of range."""
        fields: dict[str, Any] = {
            "t_ns": 0,
            "goal_id": self.goal_id,
            "forward_mps": forward_mps,
            "right_mps": right_mps,
            "up_mps": up_mps,
            "yaw_rate_rps": yaw_rate_rps,
        }
        try:
            return msgspec.convert(fields, VelocityCommand)
        except msgspec.ValidationError as error:
            raise ValueError(f"velocity command: {mistake(error, VelocityCommand)}") from None

    def _drain(self) -> None:
        """Process the feedback that has come."""
        with suppress(TimedOut):
            while self.next_feedback(0.0) is not None:
                pass

    def _publish(self, command: VelocityCommand) -> int:
        """Publish a command with the present vehicle time; returns that time."""
        if self._ended:
            self.result()
            raise Refused("the goal has succeeded already: nothing follows a velocity command")
        t_ns = self._now_ns()
        if t_ns is None:
            raise TimedOut("no feedback for a second: the velocity command has no vehicle time")
        self._connection.publish(VELOCITY_COMMAND, msgspec.structs.replace(command, t_ns=t_ns))
        return t_ns

    def _publish_last(self) -> None:
        """Publish the command that ends the goal, if the vehicle time is known."""
        t_ns = self._now_ns()
        if t_ns is not None:
            command = VelocityCommand(t_ns=t_ns, goal_id=self.goal_id, is_last=True)
            self._connection.publish(VELOCITY_COMMAND, command)

    def _process(self, data: bytes) -> VelocityFeedback | None:
        feedback = super()._process(data)
        if feedback is not None:
            self.newest, self._heard_s = feedback, time.monotonic()
        return feedback

    def _now_ns(self) -> int | None:
        """Vehicle time by the newest feedback; None without one for a second.

        The connection's vehicle time won't do: it ignores a clock that has once stood still, as it may be an old one.
        """
        return self._feedback_t_ns if time.monotonic() - self._heard_s <= FEEDBACK_TIMEOUT_S else None
