"""Arming, modes and failsafes: what the autopilot may do, and what it does when something is lost."""

from collections.abc import Iterator

import msgspec

from jezero.services.autopilot.config import CommanderConfig, FailsafeConfig
from jezero.services.autopilot.failsafes import MODE_OF, Action, Trigger, respond
from jezero.services.autopilot.modes import DOWN, Mode


class Condition(msgspec.Struct, frozen=True, gc=False):
    """What the commander looks at in each step.

    Attributes:
        t_us: time of the sensors.
        not_armable: why the vehicle must not arm, "" when it may.
        position_lost: why there is no position to fly with, "" when there is.
        stream_age_s: of the newest offboard setpoint.
        landed: the land detector's word.
        tilt_rad: of the body against the vertical.
        link_age_s: of the newest heartbeat of a ground station.
        battery_remaining: share of the capacity.
    """

    t_us: int
    not_armable: str
    position_lost: str
    stream_age_s: float
    landed: bool
    tilt_rad: float
    link_age_s: float = 0.0
    battery_remaining: float = 1.0


class Commander:
    """The autopilot's state machine.

    Attributes:
        armed: motors may turn.
        mode: what flies the vehicle.
        failsafe: the mode was chosen by a failsafe, not by a command.
    """

    def __init__(self, config: CommanderConfig, failsafe: FailsafeConfig) -> None:
        self.configure(config, failsafe)
        self.armed = False
        self.mode = Mode.HOLD
        self.failsafe = False
        self._has_flown = False
        self._landed_us: int | None = None
        self._upright_us = 0
        self._overruled: tuple[Trigger, ...] = ()
        """Wrong already when somebody last commanded a mode: it is his decision, as long as it stays wrong."""
        self._warned: tuple[Trigger, ...] = ()
        self._said: list[tuple[int, str]] = []

    def configure(self, config: CommanderConfig, failsafe: FailsafeConfig) -> None:
        """New settings."""
        self._config = config
        self._failsafe = failsafe

    def take_said(self) -> list[tuple[int, str]]:
        """(severity, sentence) pairs that nobody has taken yet; 3 is an error, 4 a warning, 6 information."""
        said, self._said = self._said, []
        return said

    # -- commands; each returns why it is refused, or "" --

    def arm(self, now: Condition) -> str:
        """Arm, if every check passes."""
        if self.armed:
            return ""
        reason = self.not_armable(now)
        if not reason and self.mode in DOWN:
            reason = f"the mode is {self.mode.value}, choose another first"
        if not reason and self.mode is Mode.OFFBOARD and now.stream_age_s > self._config.offboard_stream_s:
            reason = "offboard mode without setpoints"
        if reason:
            self.say(3, f"Arming denied: {reason}")
            return reason
        self.armed = True
        self.failsafe = False
        self._upright_us = now.t_us
        self._has_flown = False
        self._landed_us = None
        self._overruled = self._warned = ()
        self.say(6, "Armed by external command")
        return ""

    def not_armable(self, now: Condition) -> str:
        """Why the vehicle must not arm, whatever its mode."""
        if now.not_armable:
            return now.not_armable
        if now.battery_remaining < self._failsafe.bat_crit_thr:
            return f"the battery has {100.0 * now.battery_remaining:.0f} % left"
        if self._failsafe.nav_dll_act and now.link_age_s > self._failsafe.com_dl_loss_t_s:
            return "no ground station is heard, and NAV_DLL_ACT wants one"
        return ""

    def disarm(self, now: Condition, *, force: bool) -> str:
        """Disarm on the ground, or anywhere by force."""
        if not self.armed:
            return ""
        if not (now.landed or force):
            self.say(3, "Disarming denied: not landed")
            return "not landed"
        self._disarm("Disarmed by force" if force and not now.landed else "Disarmed by external command")
        return ""

    def set_mode(self, mode: Mode, now: Condition) -> str:
        """Switch to another mode."""
        reason = ""
        if mode is Mode.LAND and self.armed and now.position_lost:
            mode = Mode.DESCEND
        elif mode is Mode.OFFBOARD and now.stream_age_s > self._config.offboard_stream_s:
            reason = "no offboard setpoints"
        elif now.position_lost:
            reason = now.position_lost
        if reason:
            self.say(4, f"Switching to {mode.value} mode denied: {reason}")
            return reason
        self.failsafe = False
        self._overruled = tuple(self._triggers(now))
        self.switch(mode)
        return ""

    def switch(self, mode: Mode) -> None:
        """To the mode that follows of itself, such as hold after takeoff."""
        if mode is not self.mode:
            self.mode = mode
            self.say(6, f"Mode: {mode.value}")

    # -- time --

    def tick(self, now: Condition) -> None:
        """Look after failsafes and automatic disarming."""
        if not self.armed:
            return
        if now.tilt_rad <= self._failsafe.fd_fail_tilt_rad:
            self._upright_us = now.t_us
        self._answer(tuple(self._triggers(now)), now.landed)
        if self.armed:
            self._disarm_by_itself(now)

    def _triggers(self, now: Condition) -> Iterator[Trigger]:
        """What is wrong now."""
        c = self._failsafe
        if now.stream_age_s > c.com_of_loss_t_s:
            yield Trigger.OFFBOARD_LOST
        if c.nav_dll_act and now.link_age_s > c.com_dl_loss_t_s:
            yield Trigger.LINK_LOST
        if level := self.battery_level(now.battery_remaining):
            yield _BATTERY[level - 1]
        if now.position_lost:
            yield Trigger.POSITION_LOST
        if self.armed and _seconds(now.t_us - self._upright_us) >= c.fd_fail_s:
            yield Trigger.TILTED

    def battery_level(self, remaining: float) -> int:
        """0 when there is enough, then low, critical, emergency."""
        c = self._failsafe
        return (remaining < c.bat_low_thr) + (remaining < c.bat_crit_thr) + (remaining < c.bat_emergen_thr)

    def _answer(self, triggers: tuple[Trigger, ...], landed: bool) -> None:
        """Do what the failsafes want."""
        if self._overruled:
            self._overruled = tuple(trigger for trigger in self._overruled if trigger in triggers)
        if self._warned:
            self._warned = tuple(trigger for trigger in self._warned if trigger in triggers)
        if not triggers:
            return
        new = [t for t in triggers if t not in self._overruled or t is Trigger.OFFBOARD_LOST]
        action, because = respond(new, self.mode, landed, self._failsafe)
        if because is None:
            return
        if action is Action.WARN:
            if because not in self._warned:
                self._warned = (*self._warned, because)
                self.say(4, f"Warning: {because.value}")
        elif action is Action.DISARM:
            self._disarm(f"Failsafe: {because.value}, motors off", severity=2)
        else:
            self.say(3, f"Failsafe: {because.value}, {_DOING[action]}")
            self.failsafe = True
            self.switch(MODE_OF[action])

    def _disarm_by_itself(self, now: Condition) -> None:
        c = self._config
        if not now.landed:
            self._has_flown = True
            self._landed_us = None
            return
        if self._landed_us is None:
            self._landed_us = now.t_us
        since_s = _seconds(now.t_us - self._landed_us)
        if self._has_flown and since_s >= c.com_disarm_land_s:
            self._disarm("Disarmed by landing")
        elif not self._has_flown and since_s >= c.com_disarm_prflt_s:
            self._disarm("Disarmed by auto preflight disarming")

    def _disarm(self, text: str, severity: int = 6) -> None:
        self.armed = False
        self.say(severity, text)
        self.failsafe = False
        if self.mode in DOWN or self.mode is Mode.TAKEOFF:
            self.switch(Mode.HOLD)

    def say(self, severity: int, text: str) -> None:
        """To be told by whoever takes it next."""
        self._said.append((severity, text))


_BATTERY = (Trigger.BATTERY_LOW, Trigger.BATTERY_CRITICAL, Trigger.BATTERY_EMERGENCY)
_DOING = {
    Action.HOLD: "holding",
    Action.RETURN: "returning",
    Action.LAND: "landing",
    Action.DESCEND: "descending where it is",
}


def _seconds(us: int) -> float:
    return us * 1e-6
