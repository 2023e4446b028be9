"""The epoch of the vehicle that the bridge commands."""

from collections.abc import Iterable

AUTOPILOT_SILENT_NS = 300_000_000
"""Time without telemetry after which another vehicle may be at the other end of the link."""
AUTOPILOT_RESTART_NS = 5_000_000_000
"""A new epoch belongs to a silence, or to a restart, of the autopilot that is not longer ago."""
UNCONFIRMED_MAX_NS = 3_000_000_000
"""An epoch that only the clock has changed for this time, without a message of the old one, is believed too."""


class VehicleEpoch:
    """Decides whether a clock with another epoch means that the vehicle was restarted; the autopilot must confirm it.

    The autopilot of a restarted vehicle was silent, or its time stepped back. A message of the clock alone may be
    anybody's, and must not end a goal.

    Attributes:
        epoch_id: the present epoch; None before the first message of the clock.
    """

    def __init__(self) -> None:
        self.epoch_id: int | None = None
        self._new_id = 0
        self._new_since_ns: int | None = None
        """Wall time of the first message of a new epoch; None without one."""
        self._restart_ns: int | None = None
        """Wall time at which the autopilot was last silent, or restarted."""

    def note_autopilot(self, wall_ns: int, received_wall_ns: int | None, *, restarted: bool = False) -> None:
        """Update with the wall time of the last telemetry, and with a restart of the autopilot."""
        if restarted or received_wall_ns is None or wall_ns - received_wall_ns >= AUTOPILOT_SILENT_NS:
            self._restart_ns = wall_ns

    def update(self, epoch_ids: Iterable[int], wall_ns: int) -> bool:
        """Update with the messages of the clock; returns whether another vehicle is there."""
        for epoch_id in epoch_ids:
            if self.epoch_id is None:
                self.epoch_id = epoch_id
            if epoch_id == self.epoch_id:
                self._new_since_ns = None
            elif self._new_since_ns is None or epoch_id != self._new_id:
                self._new_id, self._new_since_ns = epoch_id, wall_ns
        if self._new_since_ns is None:
            return False
        confirmed = self._restart_ns is not None and wall_ns - self._restart_ns <= AUTOPILOT_RESTART_NS
        if not confirmed and wall_ns - self._new_since_ns < UNCONFIRMED_MAX_NS:
            return False
        self.epoch_id, self._new_since_ns = self._new_id, None
        return True
