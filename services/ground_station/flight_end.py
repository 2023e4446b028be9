"""What ended the last flight before its time, kept until a person has taken note of it."""

from dataclasses import dataclass

from jezero.schemas.state import InCharge, Status, StatusCode

BY: dict[InCharge, str] = {"external": "Taken over by an external pilot", "failsafe": "Ended by a failsafe"}


@dataclass(frozen=True)
class FlightEnd:
    """A loss of control by the bridge: motors cut, a crash, a failsafe or a takeover.

    Attributes:
        t_s: time at which it arrived, on the clock that the caller of `FlightEndDetector` uses.
        words: what happened, with the bridge's reason.
    """

    t_s: float
    words: str


class FlightEndDetector:
    """Detects from the status that the bridge lost control of the vehicle.

    Attributes:
        newest: the newest loss that nobody has taken note of, and from which control was not taken back; None without
            one.
    """

    def __init__(self) -> None:
        self.newest: FlightEnd | None = None
        self._last: Status | None = None

    def update(self, now_s: float, status: Status) -> None:
        """Compare a status with the one before."""
        last, self._last = self._last, status
        was_lost = last is not None and last.in_charge in BY
        if status.in_charge in BY and (last is None or last.in_charge != status.in_charge):
            self.newest = FlightEnd(now_s, _words(status))
        elif was_lost and status.code == StatusCode.HOVER:  # a person has taken control back
            self.newest = None

    def take_note(self) -> None:
        """Forget the newest loss: a person has seen it."""
        self.newest = None


def _words(status: Status) -> str:
    reason = status.text
    if reason.startswith("motors cut"):
        return reason[0].upper() + reason[1:]
    return f"{BY[status.in_charge]}: {reason.removeprefix('failsafe: ').removeprefix('taken over: ')}"
