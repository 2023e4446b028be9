"""The camera's axes."""

from collections.abc import Iterable

from jezero.schemas.commands import CameraPitch
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.camera.config import CameraConfig

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000


class Gimbal:
    """Follows the newest command at a bounded rate; returns to rest when nobody commands any more.

    Attributes:
        pitch_rad, roll_rad, pitch_rate_rps, roll_rate_rps: as of the last `move`.
    """

    def __init__(self, config: CameraConfig) -> None:
        self._config = config
        self._command: CameraPitch | None = None
        self._moved_ns: int | None = None
        self.pitch_rad = config.pitch_rest_rad
        self.roll_rad = self.pitch_rate_rps = self.roll_rate_rps = 0.0

    def take(self, t_ns: int, commands: Iterable[CameraPitch]) -> None:
        """Commands that arrived; those that are older than 0.3 s, or than the present one, change nothing."""
        for command in commands:
            newer = self._command is None or command.t_ns >= self._command.t_ns
            if newer and -LEAD_MAX_NS <= t_ns - command.t_ns <= AGE_MAX_NS:
                self._command = command

    def move(self, t_ns: int) -> None:
        """Go on to a later time; an earlier one (the clock has started anew) leaves the axes where they are."""
        if self._command is not None and abs(t_ns - self._command.t_ns) > self._config.hold_pitch_s * NS_PER_S:
            self._command = None
        command = self._command
        pitch_rad = self._config.pitch_rest_rad if command is None else command.pitch_camera_rad
        roll_rad = 0.0 if command is None else command.roll_camera_rad
        dt_s = 0.0 if self._moved_ns is None else max(0, t_ns - self._moved_ns) / NS_PER_S
        self._moved_ns = t_ns
        self.pitch_rad, self.pitch_rate_rps = self._turned(dt_s, self.pitch_rad, pitch_rad)
        self.roll_rad, self.roll_rate_rps = self._turned(dt_s, self.roll_rad, roll_rad)

    def _turned(self, dt_s: float, now_rad: float, wanted_rad: float) -> tuple[float, float]:
        """Where an axis is after a time, and how fast it turned."""
        reach_rad = self._config.axis_rate_max_rps * dt_s
        way_rad = min(reach_rad, max(-reach_rad, wanted_rad - now_rad))
        return now_rad + way_rad, way_rad / dt_s if dt_s > 0.0 else 0.0
