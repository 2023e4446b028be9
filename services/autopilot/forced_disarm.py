"""Who may stop the motors in the air by a forced disarm over the link of ground stations, where ids are claimed."""

import sys
from collections.abc import Sequence


class ForcedDisarmRule:
    """Decides whether a MAVLink system on the link of ground stations may disarm by force in the air.

    Args:
        listed: ids of the systems that may; none leaves it to those that sent something before the takeoff.
    """

    def __init__(self, listed: Sequence[int]) -> None:
        self._listed = frozenset(listed)
        self._seen: set[int] = set()
        self._logged: set[str] = set()
        """Sentences that are in the log since the takeoff: a flood of commands must not fill it."""

    def on_message_on_ground(self, system_id: int) -> None:
        """Note who sends something while the vehicle is landed."""
        self._seen.add(system_id)
        self._logged.clear()

    def refusal(self, system_id: int) -> str:
        """Why a system may not disarm by force in the air; "" when it may."""
        if system_id in (self._listed or self._seen):
            return ""
        if self._listed:
            return f"MAVLink system {system_id} is not in force_disarm_systems"
        return f"MAVLink system {system_id} sent nothing before the takeoff"

    def log(self, sentence: str) -> None:
        """Print a sentence into the log of the autopilot, once in a flight."""
        if sentence not in self._logged:
            self._logged.add(sentence)
            print(sentence, file=sys.stderr, flush=True)
