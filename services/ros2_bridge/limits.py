"""How often clients of ROS reach the vehicle: the bridge is one of many clients, whoever floods it."""

import re

REQUESTS_MAX_HZ = 10.0
"""Greatest rate of all goals and changes of parameters together, and of the requests of each service that ends a
goal."""
POSE_PERIOD_S = 0.2
"""Shortest time between two poses of `goal_pose` that are flown to: the newest one is taken."""


REFUSAL_PERIOD_S = 2.0
"""A refusal is published once in this time, however fast its cause repeats itself."""
NUMBER = re.compile(r"\d[\d.]*")


class Announcements:
    """Decides which refusals are announced: of those that differ in their numbers only, one in REFUSAL_PERIOD_S."""

    def __init__(self) -> None:
        self._announced_s: dict[tuple[str, str], float] = {}

    def is_due(self, what: str, reason: str, now_s: float) -> bool:
        """Whether a refusal is to be announced now.

        Args:
            what: the thing that was refused, such as the name of an action.
            reason: why it was refused, for people.
            now_s: time of any clock that never steps.
        """
        recent = {key: at_s for key, at_s in self._announced_s.items() if now_s - at_s < REFUSAL_PERIOD_S}
        self._announced_s = recent
        key = what, NUMBER.sub("", reason)
        if key in recent:
            return False
        recent[key] = now_s
        return True


class RequestLimit:
    """Passes as many requests in a second as a person and a program together need.

    Two threads at one time may pass one more.

    Args:
        max_hz: requests that pass in one second.
    """

    def __init__(self, max_hz: float = REQUESTS_MAX_HZ) -> None:
        self._max_hz = max_hz
        self._room, self._last_s = max_hz, 0.0

    def refusal(self, now_s: float) -> str:
        """Why a request that arrives now does not pass; "" for one that does.

        Args:
            now_s: time of any clock that never steps.
        """
        self._room = min(self._room + (now_s - self._last_s) * self._max_hz, self._max_hz)
        self._last_s = now_s
        if self._room < 1.0:
            return f"the bridge passes {self._max_hz:g} requests a second"
        self._room -= 1.0
        return ""
