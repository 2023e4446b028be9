"""Ends a goal whose autopilot was wrong about where the vehicle is, or where it points.

After a step of the autopilot's position a goal's points move along with it (spec §1). That keeps the vehicle from
jumping, and lets a goal succeed somewhere else than it was asked to. So a goal only bears small steps.
"""

from math import degrees

from jezero.frames import horizontal, subtract
from jezero.heading_step import CHECK, heading_step_rad
from jezero.schemas.state import Odometry
from jezero.services.actions.motion.behaviour import Move

SUM_MAX_M = 1.0
"""Greatest sum of the horizontal steps of the position within one goal."""


class ResetWatch:
    """Sums up the steps of one goal.

    Args:
        odometry: at the start of the goal.
    """

    def __init__(self, odometry: Odometry) -> None:
        self._last = odometry
        self._sum_m = 0.0
        self._steps = 0

    def problem(self, odometry: Odometry, move: Move) -> str:
        """Add the newest odometry; returns the reason why the goal must end, or ""."""
        last, self._last = self._last, odometry
        if odometry.reset_counter == last.reset_counter:
            return ""
        if turned_rad := heading_step_rad(last, odometry):
            turned_deg = abs(degrees(turned_rad))
            return (
                f"the autopilot turned its heading by {turned_deg:.0f}° in one step, as the vehicle's motion "
                f"contradicts the compass: {CHECK}"
            )
        step_m = horizontal(subtract(odometry.reset_offset_ned_m, last.reset_offset_ned_m))
        self._sum_m += step_m
        self._steps += step_m > 0.0
        if self._sum_m <= SUM_MAX_M or move.frame is not None:
            return ""
        steps = "one step" if self._steps == 1 else f"{self._steps} steps"
        return (
            f"the autopilot corrected its position by {self._sum_m:.1f} m in {steps} during the goal, and the goal's "
            f"points moved along; {SUM_MAX_M:g} m is the limit: check GNSS and the compass, then send the goal again"
        )
