"""Detection of sensors that repeat one reading."""

REPEATS_MAX = 2
"""The noise of a working sensor may produce the same reading this many times in a row."""


class FrozenSensorDetector:
    """Detects a sensor that repeats its reading to the last digit; the readings of a working sensor carry noise."""

    def __init__(self) -> None:
        self._last: object = None
        self._repeats = 0

    def is_frozen(self, reading: object) -> bool:
        """Compare a reading with the one before it. Call it once for every reading."""
        self._repeats = self._repeats + 1 if reading == self._last else 0
        self._last = reading
        return self._repeats > REPEATS_MAX
