"""Detects a gate whose links are up and pass nothing, by the beats of all gates.

Each gate publishes once a second, and replies, which other gates it is linked with. Both take the way of status and
requests: from router to gate, over the link, and from gate to router. So a gate with which this computer's own is
linked, and of which no beat or no reply arrives here, has a link that passes nothing.
"""

from dataclasses import dataclass

from jezero.schemas.health import GateLinks

SILENT_MAX_S = 4.0
"""Time without a beat, or without a reply, after which a link passes nothing. A lost radio ends its link after 2 s."""
RESTART_PERIOD_MIN_S, RESTART_PERIOD_MAX_S = 20.0, 600.0
"""Time from one restart to the next; it doubles as long as they don't help."""


@dataclass
class _Heard:
    """When a gate was last heard of; monotonic times. Both begin with what is heard first.

    A gate that begins anew for its keys gets another id and stays the same process: it is no gate that has been silent
    since its process started.
    """

    beat_s: float
    reply_s: float


class GateWatch:
    """Watches the gate of this computer. Messages come from other threads than the launcher's."""

    def __init__(self) -> None:
        self._heard: dict[str, _Heard] = {}
        """The last beat and reply of each gate, with the id of the gate as key."""
        self._links: dict[str, GateLinks] = {}
        """The newest links of each gate, by its process."""
        self._linked_s: dict[str, float] = {}
        """Time since when the own gate is linked with each other one."""
        self._restarted_s = float("-inf")
        self._period_s = RESTART_PERIOD_MIN_S

    def on_beat(self, links: GateLinks, now_s: float, *, is_reply: bool) -> None:
        """Update with a beat or a reply."""
        heard = self._heard.setdefault(links.gate, _Heard(now_s, now_s))
        if is_reply:
            heard.reply_s = now_s
        else:
            heard.beat_s = now_s
        self._links[links.process] = links

    def problem(self, process: str, started_s: float, now_s: float) -> str:
        """Why the own gate is to be started anew now, or "".

        Args:
            process: host and process id of the own gate.
            started_s: monotonic time of its start.
            now_s: monotonic time.
        """
        own = self._links.get(process)
        others = () if own is None else own.linked
        self._linked_s = {gate: self._linked_s.get(gate, now_s) for gate in others}
        reasons = [self._silence("" if own is None else own.gate, started_s, now_s, "the gate itself")]
        reasons += [
            self._silence(gate, since_s, now_s, f"the link with the gate {gate}")
            for gate, since_s in self._linked_s.items()
        ]
        reason = next(filter(None, reasons), "")
        if not reason or now_s - self._restarted_s < self._period_s:
            return ""
        is_first = now_s - self._restarted_s > 2 * RESTART_PERIOD_MAX_S
        self._period_s = RESTART_PERIOD_MIN_S if is_first else min(2 * self._period_s, RESTART_PERIOD_MAX_S)
        self._restarted_s = now_s
        return reason

    def _silence(self, gate: str, since_s: float, now_s: float, what: str) -> str:
        """What is missing of a gate, or "".

        Args:
            gate: its id, "" where that isn't known yet.
            since_s: time from which on it should be heard.
            what: words for people.
        """
        heard = self._heard.get(gate, _Heard(since_s, since_s))
        for kind, last_s in (("beats", heard.beat_s), ("replies", heard.reply_s)):
            silent_s = now_s - max(last_s, since_s)
            if silent_s > SILENT_MAX_S:
                return f"{what} is up and brings no {kind} for {silent_s:.0f} s"
        return ""
