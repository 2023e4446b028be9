"""Decides when the estimate is reset to a sensor that the innovation gate rejects."""

TIMEOUT_US = 3_000_000
"""The estimate is reset to a sensor that has been rejected for this time."""
SMOOTHING = 0.2
"""Weight of the newest innovation in the mean."""


class ResetDetector:
    """Detects that a sensor has contradicted the estimate for so long, and so steadily, that the sensor must be right.

    The rejected innovations must agree with each other: those of a faulty sensor that jumps from measurement to
    measurement never lead to a reset, however long it lasts.

    Attributes:
        mean_innovation: smoothed mean of the innovations that have been rejected without a break; empty while the
            gate accepts the sensor.
    """

    def __init__(self) -> None:
        self._since_us = 0
        self._last: tuple[float, ...] = ()
        self.mean_innovation: tuple[float, ...] = ()

    def clear(self) -> None:
        """Record that the gate accepted the sensor, or that the estimate was reset to it."""
        self.mean_innovation = ()

    def update(self, t_us: int, innovation: tuple[float, ...], step_max: float) -> bool:
        """Add a rejected innovation; returns whether the estimate should be reset by `mean_innovation`.

        Args:
            innovation: measured minus expected, one value per axis.
            step_max: an innovation that differs from the last one by more than this restarts the timeout.
        """
        if not self.mean_innovation or any(
            abs(value - last) > step_max for value, last in zip(innovation, self._last, strict=True)
        ):
            self._since_us, self.mean_innovation = t_us, innovation
        self._last = innovation
        self.mean_innovation = tuple(
            mean + SMOOTHING * (value - mean) for mean, value in zip(self.mean_innovation, innovation, strict=True)
        )
        return t_us - self._since_us >= TIMEOUT_US
