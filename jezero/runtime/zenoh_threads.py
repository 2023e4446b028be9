"""Zenoh's own threads, made at home in Python.

A callback may run in the thread of Zenoh's that receives, which saves waking one of Python's. But Python would meet
that thread anew in each callback: make a state for it, with a stack, and throw it away afterwards, which takes as long
as waking another thread, some 40 us. So each thread that calls back stays known from its first callback on.

For processes that close their session before they exit: after that nothing may call back.
"""

import ctypes
from collections.abc import Callable
from threading import get_ident
from typing import Any, TypeVar

import zenoh

T = TypeVar("T")

_known: set[int] = set()
"""Threads whose state Python keeps."""


def where_received(callback: Callable[[T], None], drop: Callable[[], None] | None = None) -> Any:
    """Zenoh's handler that calls back in the thread that receives.

    Args:
        drop: called when nothing more will come.
    """

    def call(item: T) -> None:
        if get_ident() not in _known:
            _keep_thread_state()
        callback(item)

    return zenoh.handlers.Callback(call, drop, indirect=False)


def _keep_thread_state() -> None:
    """Of the calling thread: one more who needs it, and never lets go."""
    _known.add(get_ident())
    ctypes.pythonapi.PyGILState_Ensure()
