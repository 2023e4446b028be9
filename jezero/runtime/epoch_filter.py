"""Which messages of the clock are followed: those of its one master."""

from jezero.codec import BadPayloadError, decode
from jezero.schemas.state import Clock

EPOCH_SILENT_NS = 500_000_000
"""Wall time without a message of an epoch after which another epoch is followed. A master sends every 0.1 s of vehicle
time, which are 0.4 s where it is slowest."""


class EpochFilter:
    """Separates the clock's messages of the one time master from those of anybody else.

    A master that starts a new epoch sends nothing of the old one any more. While the old one is heard, a message with
    another epoch is somebody else's, and must not end goals or shift vehicle time.
    """

    def __init__(self) -> None:
        self._epoch_id: int | None = None
        self._heard_ns = 0
        """Wall time of the last message of the epoch that is followed."""

    def refusal(self, data: bytes, wall_ns: int) -> str:
        """Reason why a message of the clock is not followed, or "".

        Args:
            data: the message; one that can't be decoded is left to whoever decodes it.
            wall_ns: monotonic wall time of its arrival.
        """
        try:
            clock: Clock = decode(Clock, data)
        except BadPayloadError:
            return ""
        if self._epoch_id not in (None, clock.epoch_id) and wall_ns - self._heard_ns < EPOCH_SILENT_NS:
            return f"epoch {clock.epoch_id} while the clock of epoch {self._epoch_id} goes on: a second time master?"
        self._epoch_id, self._heard_ns = clock.epoch_id, wall_ns
        return ""
