"""Decides which readings of the compass correct the heading.

In the air the gyroscope carries the heading for minutes, while a compass near iron or a current can jump by any angle
and stay there. So a compass that contradicts the heading is rejected for as long as it does. On the ground the heading
is reset to a compass that insists, because the vehicle may have been turned while the filter was disturbed.
"""

from math import atan2, cos, degrees, sin
from typing import Literal

from jezero.services.autopilot.reset_detector import ResetDetector

REOPENS_AFTER = 10
"""After a rejected reading, the compass is fused again when this number of readings in a row lie within the gate. With
noise, single readings of a wrong compass lie within the gate too, and each of them would pull the heading."""


class HeadingGate:
    """Gate of the compass' innovations.

    Attributes:
        landed: whether the vehicle is on the ground.
    """

    def __init__(self) -> None:
        self.landed = True
        self._detector = ResetDetector()
        """Its innovation is the cosine and sine of the heading's innovation, which can be averaged."""
        self._good = REOPENS_AFTER
        """Number of readings within the gate since the last rejected one."""

    @property
    def error_rad(self) -> float:
        """Smoothed innovation while readings are rejected, otherwise 0."""
        if not self._detector.mean_innovation:
            return 0.0
        cosine, sine = self._detector.mean_innovation
        return atan2(sine, cosine)

    @property
    def rejection_reason(self) -> str:
        """Text on the compass that is being rejected, or ""."""
        if not self._detector.mean_innovation:
            return ""
        return f"the magnetometer's heading is {abs(degrees(self.error_rad)):.0f} degrees off the estimate"

    def judge(self, t_us: int, error_rad: float, gate_rad: float) -> Literal["fuse", "reject", "reset"]:
        """Judge one reading; on "reset" the heading is reset by `error_rad`, then `clear` is called.

        Args:
            error_rad: innovation, the heading of the compass minus the estimated one.
            gate_rad: greatest innovation that is fused.
        """
        if abs(error_rad) < gate_rad:
            self._good += 1
            if self._good < REOPENS_AFTER:
                return "reject"
            self.clear()
            return "fuse"
        self._good = 0
        insists = self._detector.update(t_us, (cos(error_rad), sin(error_rad)), gate_rad)
        return "reset" if insists and self.landed else "reject"

    def clear(self) -> None:
        """Forget the rejected readings."""
        self._detector.clear()
        self._good = REOPENS_AFTER
