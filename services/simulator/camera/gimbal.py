"""The camera's axes."""

from collections.abc import Iterable

from jezero.schemas.commands import CameraPitch
from jezero.schemas.units import NS_PER_S

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000
HOLD_NS = NS_PER_S
"""A commanded pitch is held for this time after the last command; then the axes return to rest."""


class Gimbal:
    """Follows the newest command at a bounded rate; returns to rest when nobody commands any more.

    Args:
        rest_rad: pitch and roll at rest.
        rate_max_rps: greatest rate at which the axes turn.

    Attributes:
        pitch_rad: pitch after the last `move`.
        roll_rad: roll after the last `move`.
        pitch_rate_rps: rate of the pitch during the last `move`.
        roll_rate_rps: rate of the roll during the last `move`.
    """

    def __init__(self, rest_rad: tuple[float, float], rate_max_rps: float) -> None:
        self._rest_rad = rest_rad
        self._rate_max_rps = rate_max_rps
        self._command: CameraPitch | None = None
        self._moved_ns: int | None = None
        self.pitch_rad, self.roll_rad = rest_rad
        self.pitch_rate_rps = self.roll_rate_rps = 0.0

    def update(self, t_ns: int, commands: Iterable[CameraPitch]) -> None:
        """Take new commands; those that are older than 0.3 s, or than the present one, change nothing."""
        for command in commands:
            newer = self._command is None or command.t_ns >= self._command.t_ns
            if newer and -LEAD_MAX_NS <= t_ns - command.t_ns <= AGE_MAX_NS:
                self._command = command

    def move(self, t_ns: int) -> None:
        """Turn the axes until a later time; an earlier time (the clock was restarted) leaves them where they are."""
        if self._command is not None and abs(t_ns - self._command.t_ns) > HOLD_NS:
            self._command = None
        command = self._command
        pitch_rad, roll_rad = self._rest_rad
        if command is not None:
            pitch_rad, roll_rad = command.pitch_camera_rad, command.roll_camera_rad
        dt_s = 0.0 if self._moved_ns is None else max(0, t_ns - self._moved_ns) / NS_PER_S
        self._moved_ns = t_ns
        self.pitch_rad, self.pitch_rate_rps = self._turned(dt_s, self.pitch_rad, pitch_rad)
        self.roll_rad, self.roll_rate_rps = self._turned(dt_s, self.roll_rad, roll_rad)

    def _turned(self, dt_s: float, now_rad: float, target_rad: float) -> tuple[float, float]:
        """Angle of an axis after a time, and the rate at which it turned."""
        reach_rad = self._rate_max_rps * dt_s
        way_rad = min(reach_rad, max(-reach_rad, target_rad - now_rad))
        return now_rad + way_rad, way_rad / dt_s if dt_s > 0.0 else 0.0
