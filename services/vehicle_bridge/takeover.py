"""The signs that somebody else flies: another MAVLink system, or the autopilot's failsafe. Source: architecture §5."""

from jezero.schemas.state import InCharge
from jezero.services.vehicle_bridge.vehicle import OFFBOARD, UNARMABLE_MODES, Situation

LEFT_S = 0.3
"""A vehicle that was about to arm and isn't in offboard mode any more for so long was given another mode."""
TIDY_S = 5.0
"""After the bridge's own flight the autopilot is asked for this long to leave a mode in which it can't be armed."""
ABANDONED_S = 2.0
ABANDONED_WITHIN_S = 10.0
"""After somebody else's flight, only if it has stood in that mode, unable to arm, for so long; and not any later."""


class Takeover:
    """Watches the autopilot for what the bridge didn't ask it to do; each answer is in words, "" when there is none."""

    def __init__(self) -> None:
        self._offboard_ns: int | None = None
        """When the autopilot, asked to arm, was last seen in offboard mode."""
        self._seen: tuple[str, bool] = ("", False)
        """While others fly: the mode, and whether a failsafe chose it."""

    def begin(self, now: Situation) -> None:
        """The status is another one than before."""
        self._offboard_ns = None
        self._seen = (now.mode, now.failsafe)

    @property
    def was_offboard(self) -> bool:
        """The vehicle was about to arm in offboard mode; if it isn't in it any more, it must not be asked again."""
        return self._offboard_ns is not None

    def before_lift_off(self, now: Situation, *, asked_to_arm: bool) -> str:
        """While the bridge still asks for offboard mode and arming, somebody may be quicker."""
        if now.armed and not (asked_to_arm and now.mode == OFFBOARD):
            return "armed, and not by the bridge"
        if now.mode == OFFBOARD:
            self._offboard_ns = now.timer_ns if asked_to_arm else None
        elif self._offboard_ns is not None and (now.timer_ns - self._offboard_ns) * 1e-9 >= LEFT_S:
            return f"the autopilot was switched to {now.mode}"
        return ""

    def in_flight(self, now: Situation) -> str:
        """While the bridge flies in offboard mode."""
        if now.armed and now.mode != OFFBOARD:
            return f"the autopilot was switched to {now.mode}"
        if now.armed and now.contested:
            return "the autopilot follows setpoints of somebody else"
        return ""

    def of_others(self, now: Situation) -> tuple[InCharge, str] | None:
        """While others fly, one may hand over to the other: who is in charge now, and why; None when nobody did."""
        before, self._seen = self._seen, (now.mode, now.failsafe)
        if self._seen == before or not before[0] or not now.armed:
            return None
        if now.failsafe:
            return "failsafe", f"a failsafe switched the autopilot to {now.mode}"
        return "external", f"somebody switched the autopilot to {now.mode}"


class Tidying:
    """Decides whether to lead an idle autopilot out of a mode in which it couldn't be armed again.

    PX4 returns to offboard mode when it has been landed from it, and then arms for nobody who doesn't stream.
    """

    def __init__(self) -> None:
        self._at_once = True
        self._since_ns: int | None = None
        self._armable_ns = 0

    def begin(self, now: Situation, *, at_once: bool) -> None:
        """The vehicle stands; `at_once` when nobody else has flown it."""
        self._at_once = at_once
        self._since_ns = self._armable_ns = now.timer_ns

    def is_wanted(self, now: Situation) -> bool:
        """Whether to ask for hold mode now."""
        if self._since_ns is None:
            self.begin(now, at_once=True)
        stuck = now.armed is False and now.mode in UNARMABLE_MODES
        if not stuck or now.armable:
            self._armable_ns = now.timer_ns
        held_s = (now.timer_ns - (self._since_ns or 0)) * 1e-9
        self._at_once &= held_s <= TIDY_S and (stuck or not now.mode)
        abandoned = (now.timer_ns - self._armable_ns) * 1e-9 >= ABANDONED_S and held_s <= ABANDONED_WITHIN_S
        return stuck and (self._at_once or abandoned)
