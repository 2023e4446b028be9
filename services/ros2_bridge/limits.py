"""How often clients of ROS reach the vehicle: the bridge is one of many clients, whoever floods it."""

REQUESTS_MAX_HZ = 10.0
"""Of all goals and changes of parameters together, and of each service that ends a goal."""
POSE_PERIOD_S = 0.2
"""Shortest time between two poses of `goal_pose` that are flown to: the newest one is taken."""


class RequestLimit:
    """Passes as many requests in a second as a person and a program together need.

    Two threads at one time may pass one more.

    Args:
        max_hz: requests that pass in one second.

    Attributes:
        refused: number of requests in a row that did not pass.
    """

    def __init__(self, max_hz: float = REQUESTS_MAX_HZ) -> None:
        self._max_hz = max_hz
        self._room, self._last_s = max_hz, 0.0
        self.refused = 0

    def refusal(self, now_s: float) -> str:
        """Why a request that arrives now does not pass; "" for one that does.

        Args:
            now_s: time of any clock that never steps.
        """
        self._room = min(self._room + (now_s - self._last_s) * self._max_hz, self._max_hz)
        self._last_s = now_s
        if self._room < 1.0:
            self.refused += 1
            return f"the bridge passes {self._max_hz:g} requests a second"
        self._room -= 1.0
        self.refused = 0
        return ""
