"""Threads in which the calls of `jezero.client` are executed, as they block."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from functools import partial, wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

THREADS_MAX = 64


class Threads:
    """The threads of one vehicle.

    asyncio's own threads are not used: there are few of them, for the whole program, and an abort would have to wait
    while all are busy.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(THREADS_MAX, thread_name_prefix="jezero")

    async def run(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        """Execute a function that blocks. If the task is canceled, the function is still executed to its end."""
        call = partial(function, *args, **kwargs)
        return await asyncio.get_running_loop().run_in_executor(self._pool, call)


class Wraps(Protocol):
    """An object of `jezero.aio` with the object of `jezero.client` that does its work."""

    @property
    def _threads(self) -> Threads: ...

    @property
    def _blocking(self) -> Any: ...


def in_thread(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Make a coroutine method from a method of `jezero.client`, with its arguments, docstring and errors.

    The class in whose body it is called must have the attributes of `Wraps`.
    """

    @wraps(method)
    async def call(self: Wraps, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await self._threads.run(method, self._blocking, *args, **kwargs)

    return call
