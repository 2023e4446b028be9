"""The last events of a vehicle in words, from what changes in its status and in the services' health."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from jezero.schemas.health import ServiceHealth
from jezero.schemas.state import Status
from jezero.services.ground_station.words import StateWords, Tone, in_charge, in_words

KEPT = 60


@dataclass(frozen=True)
class Event:
    """One event.

    Attributes:
        t_s: time of its arrival, on the clock that the caller of `EventLog` uses.
        tone: how it is marked.
        text: a sentence.
    """

    t_s: float
    tone: Tone
    text: str


class EventLog:
    """Collects the events of one vehicle.

    Attributes:
        count: number of events so far, also of those that are not kept any more.
    """

    def __init__(self) -> None:
        self.count = 0
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._status: Status | None = None
        self._words = ""
        self._health: dict[str, ServiceHealth] = {}

    @property
    def newest_first(self) -> Sequence[Event]:
        """The events, the newest one first."""
        return tuple(reversed(self._events))

    def add(self, t_s: float, tone: Tone, text: str) -> None:
        """Add an event, unless it repeats the last one."""
        text = in_words(text)
        if text and (not self._events or self._events[-1].text != text):
            self._events.append(Event(t_s, tone, text))
            self.count += 1

    def on_status(self, t_s: float, status: Status, state: StateWords) -> None:
        """Compare a status, and the state that it means, with those before."""
        last, self._status = self._status, status
        last_words, self._words = self._words, state.words
        if last is None:
            self.add(t_s, "plain", f"Connected: {state.words}")
            return
        if last.bridge_boot_id != status.bridge_boot_id:
            self.add(t_s, "warning", "The vehicle bridge was restarted")
        if last.epoch_id != status.epoch_id:
            self.add(t_s, "warning", "The vehicle was restarted")
        if last.armed != status.armed:
            self.add(t_s, "plain", "Motors on" if status.armed else "Motors off")
        if last.in_charge != status.in_charge and status.in_charge in ("external", "failsafe"):
            self.add(t_s, "bad", f"In charge now: {in_charge(status)}")
        if last_words != state.words:
            self.add(t_s, "good" if state.tone in ("good", "flying") else "plain", state.words)
        if last.text != status.text:
            self.add(t_s, "plain", status.text)

    def on_health(self, t_s: float, health: ServiceHealth) -> None:
        """Compare the health of a service with the one before."""
        last, self._health[health.service] = self._health.get(health.service), health
        name = health.service.replace("_", " ")
        if last is not None and last.boot_id != health.boot_id:
            self.add(t_s, "warning", f"{name} was restarted")
        elif last is not None and last.state != health.state:
            tone: Tone = "good" if health.state == "ok" else "warning"
            self.add(t_s, tone, f"{name} is {health.state}: {health.text}")
