"""Odometry as JSON, one object a line: `{"yaw_rad": 0.5, "speed_mps": 0.2}`, or with the counts of the wheels."""

from typing import Annotated

import msgspec

from jezero.base.frames import wrap_pi
from jezero.base.lines import Lines
from jezero.schemas.struct import Angle
from jezero.schemas.units import NS_PER_S
from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.motion import RoverMotion

Speed = Annotated[float, msgspec.Meta(ge=-50.0, le=50.0)]
YawRate = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
Count = Annotated[int, msgspec.Meta(ge=-(2**53), le=2**53)]
TICKS_PERIOD_MAX_NS = NS_PER_S
"""Counts that are farther apart say nothing of the speed now."""
SPEED_MAX_MPS = 50.0


class _Line(msgspec.Struct):
    """Other fields are ignored."""

    yaw_rad: Angle
    speed_mps: Speed | None = None
    yaw_rate_rps: YawRate | None = None
    roll_rad: Angle = 0.0
    pitch_rad: Angle = 0.0
    ticks: tuple[Count, Count] | None = None


class OdometryLines:
    """Reads the lines.

    Attributes:
        bad: number of lines that were damaged.
        problem: what the lines lack, for people; "" for nothing.
    """

    def __init__(self, config: RoverDriverConfig) -> None:
        self.bad = 0
        self.problem = ""
        self._lines = Lines()
        self._decoder = msgspec.json.Decoder(_Line)
        self._ticks_per_m, self._track_m = config.ticks_per_m, config.track_m
        self._last: tuple[int, float, tuple[int, int]] | None = None
        """Time of arrival, heading and counts of the last line with counts."""

    def receive(self, data: bytes, wall_ns: int) -> list[RoverMotion]:
        """Readings that are complete with these bytes, oldest first.

        Args:
            wall_ns: monotonic time of their arrival.
        """
        before = self._lines.too_long
        readings: list[RoverMotion] = []
        for line in filter(None, self._lines.receive(data)):
            try:
                found = self._decoder.decode(line)
            except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
                self.bad += 1
                continue
            if (reading := self._reading(found, wall_ns)) is not None:
                readings.append(reading)
        self.bad += self._lines.too_long - before
        return readings

    def _reading(self, line: _Line, wall_ns: int) -> RoverMotion | None:
        speed_mps, yaw_rate_rps = line.speed_mps, line.yaw_rate_rps
        if speed_mps is None:
            if line.ticks is None:
                self.problem = "its lines have neither speed_mps nor ticks"
                return None
            motion = self._motion(wall_ns, line.yaw_rad, line.ticks)
            if motion is None:
                return None
            speed_mps, turn_rps = motion
            yaw_rate_rps = turn_rps if yaw_rate_rps is None else yaw_rate_rps
        self.problem = ""
        return RoverMotion(wrap_pi(line.yaw_rad), speed_mps, yaw_rate_rps or 0.0, line.roll_rad, line.pitch_rad)

    def _motion(self, wall_ns: int, yaw_rad: float, ticks: tuple[int, int]) -> tuple[float, float] | None:
        """Speed and yaw rate by the counts since the last line; None where they say nothing.

        Lines that arrive at once have waited on the line, so the last of them is compared with the one before them.
        """
        last = self._last
        if last is None or wall_ns > last[0]:
            self._last = (wall_ns, yaw_rad, ticks)
        if last is None or not 0 < wall_ns - last[0] <= TICKS_PERIOD_MAX_NS:
            return None
        dt_s = (wall_ns - last[0]) / NS_PER_S
        left_mps, right_mps = ((ticks[i] - last[2][i]) / self._ticks_per_m / dt_s for i in range(2))
        if max(abs(left_mps), abs(right_mps)) > SPEED_MAX_MPS:  # the counter was set to zero
            return None
        turn_rps = max(-10.0, min(10.0, (left_mps - right_mps) / self._track_m))
        return 0.5 * (left_mps + right_mps), turn_rps
