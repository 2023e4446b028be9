"""The ground station as a service of the stack: publishes where its pages are, and whether they can be shown.

The pages read the bus through the SDK, as any client does: they are no inputs of this service.
"""

from collections.abc import Callable, Iterable

from jezero.runtime.service import Health, Inbox, Output, Spec

SPEC = Spec(name="ground_station", rate_hz=2.0)


class GroundStation:
    """Publishes the health of the pages.

    Args:
        health: returns the present health; called twice a second.
    """

    spec = SPEC

    def __init__(self, health: Callable[[], Health]) -> None:
        self._health = health

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        """Publish the health."""
        yield self._health()
