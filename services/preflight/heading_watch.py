"""Detects in flight that the compass is wrong, and remembers it."""

from math import degrees

from jezero.base.detectors import COMPASS_CHECK, heading_step_rad
from jezero.schemas.state import Odometry, Status


class HeadingWatch:
    """Waits for the autopilot to reset its heading in flight.

    Attributes:
        problem: what is wrong with the compass, for people, or "". It stays until the vehicle starts anew: on the
            ground nothing contradicts a compass that is mounted wrong, and the autopilot takes its heading again.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._last: Odometry | None = None

    def update(self, status: Status) -> None:
        """Update with the newest status."""
        last, self._last = self._last, status.odometry
        if last is None or status.odometry is None or status.landed or not status.armed:
            return
        if step_rad := heading_step_rad(last, status.odometry):
            self.problem = (
                f"in flight the vehicle's motion contradicted the compass by {abs(degrees(step_rad)):.0f}°: "
                f"{COMPASS_CHECK}, then start the autopilot anew"
            )
