"""Arming, modes and failsafes: what the autopilot may do, and what it does when something is lost."""

from dataclasses import dataclass
from enum import Enum

from jezero.services.autopilot.config import CommanderConfig


class Mode(Enum):
    """PX4's modes as (main mode, sub mode)."""

    POSCTL = (3, 0)
    LOITER = (4, 3)
    LAND = (4, 6)
    OFFBOARD = (6, 0)

    @property
    def custom_mode(self) -> int:
        """As HEARTBEAT carries it."""
        return self.value[0] << 16 | self.value[1] << 24


WORDS = {Mode.POSCTL: "position", Mode.LOITER: "hold", Mode.LAND: "land", Mode.OFFBOARD: "offboard"}


@dataclass(frozen=True)
class Condition:
    """What the commander looks at in each step.

    Attributes:
        t_us: time of the sensors.
        not_armable: why the vehicle must not arm, "" when it may.
        position_lost: why there is no position to fly with, "" when there is.
        stream_age_s: of the newest offboard setpoint.
        landed: the land detector's word.
        tilt_rad: of the body against the vertical.
    """

    t_us: int
    not_armable: str
    position_lost: str
    stream_age_s: float
    landed: bool
    tilt_rad: float


class Commander:
    """The autopilot's state machine.

    Attributes:
        armed: motors may turn.
        mode: what flies the vehicle.
        failsafe: the mode was chosen by a failsafe, not by a command.
        said: sentences since the last `take_said`, each with its MAVLink severity.
    """

    def __init__(self, config: CommanderConfig) -> None:
        self._config = config
        self.armed = False
        self.mode = Mode.LOITER
        self.failsafe = False
        self._armed_us = 0
        self._has_flown = False
        self._landed_us: int | None = None
        self._upright_us = 0
        self._said: list[tuple[int, str]] = []

    def take_said(self) -> list[tuple[int, str]]:
        """(severity, sentence) pairs that nobody has taken yet; 3 is an error, 4 a warning, 6 information."""
        said, self._said = self._said, []
        return said

    # -- commands; each returns why it is refused, or "" --

    def arm(self, now: Condition) -> str:
        """Arm, if every check passes."""
        if self.armed:
            return ""
        reason = now.not_armable
        if not reason and self.mode is Mode.LAND:
            reason = "the mode is land, choose another first"
        if not reason and self.mode is Mode.OFFBOARD and now.stream_age_s > self._config.offboard_stream_s:
            reason = "offboard mode without setpoints"
        if reason:
            self._say(3, f"Arming denied: {reason}")
            return reason
        self.armed = True
        self.failsafe = False
        self._armed_us = self._upright_us = now.t_us
        self._has_flown = False
        self._landed_us = None
        self._say(6, "Armed by external command")
        return ""

    def disarm(self, now: Condition, *, force: bool) -> str:
        """Disarm on the ground, or anywhere by force."""
        if not self.armed:
            return ""
        if not (now.landed or force):
            self._say(3, "Disarming denied: not landed")
            return "not landed"
        self._disarm("Disarmed by force" if force and not now.landed else "Disarmed by external command")
        return ""

    def set_mode(self, mode: Mode, now: Condition) -> str:
        """Switch to another mode."""
        reason = ""
        if mode is Mode.OFFBOARD and now.stream_age_s > self._config.offboard_stream_s:
            reason = "no offboard setpoints"
        elif now.position_lost:
            reason = now.position_lost
        if reason:
            self._say(4, f"Switching to {WORDS[mode]} mode denied: {reason}")
            return reason
        self.failsafe = False
        self._switch(mode)
        return ""

    # -- time --

    def tick(self, now: Condition) -> None:
        """Look after failsafes and automatic disarming."""
        if not self.armed:
            return
        c = self._config
        if now.tilt_rad <= c.fd_fail_tilt_rad:
            self._upright_us = now.t_us
        if _seconds(now.t_us - self._upright_us) >= c.fd_fail_s:
            self._disarm("Attitude failure: motors off", severity=2)
            return
        if self.mode is Mode.OFFBOARD and now.stream_age_s > c.com_of_loss_t_s:
            self._say(3, "Failsafe: offboard setpoints lost, landing")
            self.failsafe = True
            self._switch(Mode.LAND)
        self._disarm_by_itself(now)

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
        self._say(severity, text)
        self.failsafe = False
        if self.mode is Mode.LAND:
            self._switch(Mode.LOITER)

    def _switch(self, mode: Mode) -> None:
        if mode is not self.mode:
            self.mode = mode
            self._say(6, f"Mode: {WORDS[mode]}")

    def _say(self, severity: int, text: str) -> None:
        self._said.append((severity, text))


def _seconds(us: int) -> float:
    return us * 1e-6
