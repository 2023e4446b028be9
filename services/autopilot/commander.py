"""The commander: arming, modes, failsafes and automatic disarming."""

from collections.abc import Iterator

import msgspec

from jezero.services.autopilot.config import CommanderConfig, FailsafeConfig
from jezero.services.autopilot.failsafes import MODE_OF_ACTION, FailsafeAction, Trigger, most_severe_action
from jezero.services.autopilot.modes import DOWN, Mode

OFFBOARD_STREAM_S = 0.5
"""Maximum age of the setpoint to enter offboard mode."""


class CommanderState(msgspec.Struct, frozen=True, gc=False):
    """State of the vehicle at one time, as the commander needs it.

    Attributes:
        t_us: time stamp of the newest sensor sample.
        arming_refusal: why sensors and estimate forbid arming, "" when they allow it.
        position_invalid_reason: why the position estimate is invalid, "" when it is valid.
        offboard_setpoint_age_s: age of the newest offboard setpoint.
        landed: state of the land detector.
        tilt_rad: angle between the body's down axis and the vertical.
        gcs_lost_s: time since the connection to the last ground station was lost, 0 while it is connected.
        battery_remaining: fraction of the capacity, 0 to 1.
    """

    t_us: int
    arming_refusal: str
    position_invalid_reason: str
    offboard_setpoint_age_s: float
    landed: bool
    tilt_rad: float
    gcs_lost_s: float = 0.0
    battery_remaining: float = 1.0


class Commander:
    """State machine of arming and flight modes.

    Attributes:
        armed: whether motors may turn.
        mode: the flight mode.
        failsafe: whether a failsafe, not a command, chose the mode.
    """

    def __init__(self, config: CommanderConfig, failsafe: FailsafeConfig) -> None:
        self.configure(config, failsafe)
        self.armed = False
        self.mode = Mode.HOLD
        self.failsafe = False
        self._has_flown = False
        self._landed_us: int | None = None
        self._upright_us = 0
        self._overridden: tuple[Trigger, ...] = ()
        """Triggers that were active at the last mode command, and since. They start no action, because the operator
        chose the mode in spite of them.
        """
        self._warned_of: tuple[Trigger, ...] = ()
        self._status_texts: list[tuple[int, str]] = []

    def configure(self, config: CommanderConfig, failsafe: FailsafeConfig) -> None:
        """Apply new settings at once."""
        self._config = config
        self._failsafe = failsafe

    def pop_status_texts(self) -> list[tuple[int, str]]:
        """Return and clear the queued (severity, text) pairs; severity 3 is an error, 4 a warning, 6 information."""
        texts, self._status_texts = self._status_texts, []
        return texts

    # -- commands; each returns the reason of a refusal, or "" --

    def arm(self, state: CommanderState) -> str:
        """Arm if all arming checks pass."""
        if self.armed:
            return ""
        reason = self.arming_refusal(state)
        if not reason and self.mode in DOWN:
            reason = f"the mode is {self.mode.value}, choose another first"
        if not reason and self.mode is Mode.OFFBOARD and state.offboard_setpoint_age_s > OFFBOARD_STREAM_S:
            reason = "offboard mode without setpoints"
        if reason:
            self.add_status_text(3, f"Arming denied: {reason}")
            return reason
        self.armed = True
        self.failsafe = False
        self._upright_us = state.t_us
        self._has_flown = False
        self._landed_us = None
        self._overridden = self._warned_of = ()
        self.add_status_text(6, "Armed by external command")
        return ""

    def arming_refusal(self, state: CommanderState) -> str:
        """Run the arming checks that do not depend on the mode; returns the reason of a refusal, or ""."""
        if state.arming_refusal:
            return state.arming_refusal
        if state.battery_remaining < self._failsafe.bat_crit_thr:
            return f"the battery has {100.0 * state.battery_remaining:.0f} % left"
        if self._failsafe.nav_dll_act and state.gcs_lost_s > self._failsafe.com_dl_loss_t_s:
            return "no ground station is connected, and NAV_DLL_ACT requires one"
        return ""

    def disarm(self, state: CommanderState, *, force: bool) -> str:
        """Disarm on the ground, or in the air too if `force` is set."""
        if not self.armed:
            return ""
        if not (state.landed or force):
            self.add_status_text(3, "Disarming denied: not landed")
            return "not landed"
        self._disarm("Disarmed by force" if force and not state.landed else "Disarmed by external command")
        return ""

    def set_mode(self, mode: Mode, state: CommanderState) -> str:
        """Carry out a mode command. Land without a valid position becomes descend."""
        reason = ""
        if mode is Mode.LAND and self.armed and state.position_invalid_reason:
            mode = Mode.DESCEND
        elif mode is Mode.OFFBOARD and state.offboard_setpoint_age_s > OFFBOARD_STREAM_S:
            reason = "no offboard setpoints"
        elif state.position_invalid_reason:
            reason = state.position_invalid_reason
        if reason:
            self.add_status_text(4, f"Switching to {mode.value} mode denied: {reason}")
            return reason
        self.failsafe = False
        self._overridden = tuple(self._triggers(state))
        self.switch(mode)
        return ""

    def switch(self, mode: Mode) -> None:
        """Switch the mode without checks, e.g. to hold after a takeoff."""
        if mode is not self.mode:
            self.mode = mode
            self.add_status_text(6, f"Mode: {mode.value}")

    # -- periodic --

    def update(self, state: CommanderState) -> None:
        """Run failsafes and automatic disarming; does nothing while disarmed."""
        if not self.armed:
            return
        if state.tilt_rad <= self._failsafe.fd_fail_tilt_rad:
            self._upright_us = state.t_us
        self._apply_failsafes(tuple(self._triggers(state)), state.landed)
        if self.armed:
            self._auto_disarm(state)

    def _triggers(self, state: CommanderState) -> Iterator[Trigger]:
        """Failsafe triggers that are active now."""
        c = self._failsafe
        if state.offboard_setpoint_age_s > c.com_of_loss_t_s:
            yield Trigger.OFFBOARD_LOST
        if c.nav_dll_act and state.gcs_lost_s > c.com_dl_loss_t_s:
            yield Trigger.LINK_LOST
        if level := self.battery_level(state.battery_remaining):
            yield _BATTERY_TRIGGERS[level - 1]
        if state.position_invalid_reason:
            yield Trigger.POSITION_LOST
        if self.armed and _seconds(state.t_us - self._upright_us) >= c.fd_fail_s:
            yield Trigger.TILTED

    def battery_level(self, remaining: float) -> int:
        """Warning level of the battery: 0 normal, 1 low, 2 critical, 3 emergency."""
        c = self._failsafe
        return (remaining < c.bat_low_thr) + (remaining < c.bat_crit_thr) + (remaining < c.bat_emergen_thr)

    def _apply_failsafes(self, triggers: tuple[Trigger, ...], landed: bool) -> None:
        """Carry out the most severe action of the active triggers."""
        if self._overridden:
            self._overridden = tuple(trigger for trigger in self._overridden if trigger in triggers)
        if self._warned_of:
            self._warned_of = tuple(trigger for trigger in self._warned_of if trigger in triggers)
        if not triggers:
            return
        new = [t for t in triggers if t not in self._overridden or t is Trigger.OFFBOARD_LOST]
        action, trigger = most_severe_action(new, self.mode, landed, self._failsafe)
        if trigger is None:
            return
        if action is FailsafeAction.WARN:
            if trigger not in self._warned_of:
                self._warned_of = (*self._warned_of, trigger)
                self.add_status_text(4, f"Warning: {trigger.value}")
        elif action is FailsafeAction.DISARM:
            self._disarm(f"Failsafe: {trigger.value}, motors off", severity=2)
        else:
            self.add_status_text(3, f"Failsafe: {trigger.value}, {_TEXT_OF_ACTION[action]}")
            self.failsafe = True
            self.switch(MODE_OF_ACTION[action])

    def _auto_disarm(self, state: CommanderState) -> None:
        c = self._config
        if not state.landed:
            self._has_flown = True
            self._landed_us = None
            return
        if self._landed_us is None:
            self._landed_us = state.t_us
        since_s = _seconds(state.t_us - self._landed_us)
        if self._has_flown and since_s >= c.com_disarm_land_s:
            self._disarm("Disarmed by landing")
        elif not self._has_flown and since_s >= c.com_disarm_prflt_s:
            self._disarm("Disarmed by auto preflight disarming")

    def _disarm(self, text: str, severity: int = 6) -> None:
        self.armed = False
        self.add_status_text(severity, text)
        self.failsafe = False
        if self.mode in DOWN or self.mode is Mode.TAKEOFF:
            self.switch(Mode.HOLD)

    def add_status_text(self, severity: int, text: str) -> None:
        """Queue a text for STATUSTEXT."""
        self._status_texts.append((severity, text))


_BATTERY_TRIGGERS = (Trigger.BATTERY_LOW, Trigger.BATTERY_CRITICAL, Trigger.BATTERY_EMERGENCY)
_TEXT_OF_ACTION = {
    FailsafeAction.HOLD: "holding",
    FailsafeAction.RETURN: "returning",
    FailsafeAction.LAND: "landing",
    FailsafeAction.DESCEND: "descending",
}


def _seconds(us: int) -> float:
    return us * 1e-6
