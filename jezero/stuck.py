"""Sensors that go on telling the same."""

REPEATS_MAX = 2
"""So many times in a row a reading may equal the one before it."""


class Stuck:
    """Whether a sensor repeats itself to the last digit, as one that measures doesn't: its readings carry noise."""

    def __init__(self) -> None:
        self._last: object = None
        self._repeats = 0

    def is_so(self, reading: object) -> bool:
        """To be asked of every reading."""
        self._repeats = self._repeats + 1 if reading == self._last else 0
        self._last = reading
        return self._repeats > REPEATS_MAX
