"""An accepted goal: its feedback, its result and its cancellation."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import suppress
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar

from jezero.aio.arrivals import AsyncArrivals
from jezero.aio.threads import Threads, in_thread
from jezero.client import goal as client
from jezero.client import images, velocity
from jezero.client.errors import JezeroError, TimedOut
from jezero.client.images import Picture
from jezero.schemas.goals import ImagesFeedback, ImagesResult, VelocityFeedback, VelocityResult

F = TypeVar("F")
R = TypeVar("R")
P = ParamSpec("P")
T = TypeVar("T")


class Goal(Generic[F, R]):
    """A running goal, for one task; `async for feedback in goal` yields its feedback.

    A task that is canceled while it waits for feedback or for the result cancels its goal: the vehicle hovers. So
    `asyncio.timeout` ends the flight too, while `timeout_s` ends the wait only.
    """

    def __init__(self, threads: Threads, blocking: "client.Goal[F, R]") -> None:
        self._threads = threads
        self._blocking = blocking
        self._arrivals = AsyncArrivals(blocking._arrivals)

    def __repr__(self) -> str:
        return repr(self._blocking)

    @property
    def goal_id(self) -> str:
        """The goal's id; `Vehicle.result_of` takes it."""
        return self._blocking.goal_id

    @property
    def warning(self) -> str:
        """Which part of the goal will not be flown as requested, or ""."""
        return self._blocking.warning

    @property
    def code(self) -> int | None:
        """Status code of the vehicle in the last feedback; None before."""
        return self._blocking.code

    @property
    def remaining_s(self) -> float | None:
        """Planned time to the goal's end in the last feedback; None before, and where it is unknown."""
        return self._blocking.remaining_s

    @property
    def paused(self) -> bool:
        """Whether the goal was paused, and the vehicle hovered, in the last feedback."""
        return self._blocking.paused

    def __aiter__(self) -> AsyncIterator[F]:
        return self.feedback()

    async def feedback(self) -> AsyncIterator[F]:
        """Yield the goal's feedback until it ends; then call `result()`."""
        while (feedback := await self.next_feedback()) is not None:
            yield feedback

    async def next_feedback(self, timeout_s: float | None = None) -> F | None:
        """The next feedback; arguments and errors as of `jezero.client.goal.Goal.next_feedback`."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._blocking._ended:
            feedback = await self._next(deadline_s)
            if feedback is not None:
                return feedback
        return None

    async def result(self, timeout_s: float | None = None) -> R:
        """Wait for the goal's end; arguments, result and errors as of `jezero.client.goal.Goal.result`."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._blocking._ended:
            try:
                await self._next(deadline_s)
            except TimedOut:
                raise TimedOut(self._blocking._still_runs(timeout_s)) from None
        return self._blocking.result()  # doesn't block, as the goal has ended

    cancel = in_thread(client.Goal.cancel)
    pause = in_thread(client.Goal.pause)
    resume = in_thread(client.Goal.resume)
    modify = in_thread(client.Goal.modify)

    async def _next(self, deadline_s: float | None) -> F | None:
        """Wait for one reply and process it, or find out why there is none."""
        try:
            data = await self._arrivals.take(deadline_s)
            if data is not None:
                return self._blocking._process(data)
            await self._threads.run(self._blocking._recover, deadline_s)
        except asyncio.CancelledError:
            await cancel_with_task(self._threads, self._blocking)
            raise
        return None


async def cancel_with_task(threads: Threads, goal: "client.Goal[Any, Any]") -> None:
    """Cancel a goal because its task is canceled, and wait for the reply: the connection may be closed next."""
    with suppress(JezeroError):  # the server doesn't reply, and the task ends all the same
        await asyncio.shield(threads.run(goal.cancel))


def _canceled_with_task(
    method: Callable[Concatenate[Any, P], T],
) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Make a coroutine method as `in_thread` does; a task that is canceled while it waits there cancels its goal."""
    called = in_thread(method)

    @wraps(method)
    async def call(self: Goal[Any, Any], /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return await called(self, *args, **kwargs)
        except asyncio.CancelledError:
            await cancel_with_task(self._threads, self._blocking)
            raise

    return call


class ImagesGoal(Goal[ImagesFeedback, ImagesResult]):
    """A running goal that takes images."""

    _blocking: images.ImagesGoal

    async def pictures(
        self, on_feedback: Callable[[ImagesFeedback], None] = lambda feedback: None
    ) -> AsyncIterator[Picture]:
        """Yield each image once; arguments and errors as of `jezero.client.images.ImagesGoal.pictures`."""
        fetched: set[int] = set()
        async for feedback in self.feedback():
            on_feedback(feedback)
            for image in feedback.images:
                fetched.add(image.index)
                yield await self.picture(image)
        for image in self._blocking._images():  # doesn't block, as the goal has ended
            if image.index not in fetched:
                yield await self.picture(image)

    picture = in_thread(images.ImagesGoal.picture)


class VelocityGoal(Goal[VelocityFeedback, VelocityResult]):
    """A running flight by velocity; at the end of an `async with` block the vehicle comes to rest."""

    _blocking: velocity.VelocityGoal

    @property
    def newest(self) -> VelocityFeedback | None:
        """The newest feedback; None before."""
        return self._blocking.newest

    send = _canceled_with_task(velocity.VelocityGoal.send)
    finish = in_thread(velocity.VelocityGoal.finish)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: object, error: BaseException | None, at: object) -> None:
        if error is None:
            await self.finish()
        elif isinstance(error, asyncio.CancelledError):
            await cancel_with_task(self._threads, self._blocking)
        else:
            with suppress(JezeroError):  # the block's own error says more
                await self.finish()
