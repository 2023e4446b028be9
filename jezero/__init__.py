"""A drone that works with a rover: `from jezero import Vehicle` and fly."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jezero.client import Aborted, Canceled, Goal, JezeroError, Refused, TimedOut, Unreachable, Vehicle

__all__ = ["Aborted", "Canceled", "Goal", "JezeroError", "Refused", "TimedOut", "Unreachable", "Vehicle"]


def __getattr__(name: str) -> Any:
    """Import the client when one of its names is first used: services import `jezero` and need none of it."""
    if name not in __all__:
        raise AttributeError(f"module 'jezero' has no attribute '{name}'")
    from jezero import client

    return getattr(client, name)
