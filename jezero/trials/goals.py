"""Goals that a program sends on the memory bus, each flown to its end."""

from typing import Any

from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.schemas.actions import Rejected, Result
from jezero.schemas.rows import Action
from jezero.schemas.struct import Payload


def fly_goal(bus: MemoryBus, action: Action[Any], goal: Payload, timeout_s: float) -> str:
    """Send a goal and wait for its result; returns why it did not succeed, or ""."""
    return wait_for_result(bus, action, bus.send_request(action.endpoint, goal), timeout_s)


def wait_for_result(bus: MemoryBus, action: Action[Any], query: SentRequest, timeout_s: float) -> str:
    """Run the bus until a goal has ended; returns why it did not succeed, or "".

    Args:
        query: the goal's query; its replies arrive while the bus runs.
        timeout_s: the wait's limit in virtual time.
    """
    bus.run_for(timeout_s, stop=lambda: query.ended)
    last = query.replies[-1] if query.replies else None
    if isinstance(last, Rejected):
        return f"{action.name} refused: {last.reason}"
    if not isinstance(last, Result):
        return f"{action.name} gave no result within {timeout_s:.0f} s"
    return "" if last.outcome == "succeeded" else f"{action.name} {last.outcome}: {last.reason}"
