"""NMEA 0183 of a receiver with two antennas: its speed and course (RMC), its heading (HDT), its turn (ROT), its fix.

Source: NMEA 0183, as pynmeagps parses it.
"""

import re
from collections import deque
from math import cos, radians

from pynmeagps import NMEAMessage, NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

from jezero.base.frames import wrap_pi
from jezero.base.lines import Lines
from jezero.schemas.units import NS_PER_S
from jezero.services.rover_driver.motion import RoverMotion

KNOT_MPS = 1852.0 / 3600.0
DEGREE_PER_MINUTE_RPS = radians(1.0) / 60.0
SPEED_MAX_MPS, YAW_RATE_MAX_RPS = 50.0, 10.0
HEADING_MAX_AGE_NS = NS_PER_S // 2
"""An older heading is not that of this speed."""
TURN_WINDOW_NS = NS_PER_S // 2
"""Without ROT the yaw rate is the mean of this time, as single headings come in steps of 0.1 degrees."""
_SENTENCE = re.compile(rb"\$[A-Z]{2}(?:RMC|HDT|ROT|GGA),[ -~]*\*[0-9A-Fa-f]{2}")
_OTHER = re.compile(rb"\$[ -~]+")


class Nmea:
    """Reads the sentences.

    Attributes:
        bad: number of sentences that were damaged.
        problem: what the receiver lacks, for people; "" for nothing.
    """

    def __init__(self) -> None:
        self.bad = 0
        self.problem = ""
        self._lines = Lines()
        self._heading: tuple[int, float] | None = None
        """Time of arrival, and heading in rad."""
        self._turned: deque[tuple[int, float]] = deque()
        """The headings of the last time, without jumps at ±pi."""
        self._turn_rps: tuple[int, float] | None = None
        self._quality = 1

    def receive(self, data: bytes, wall_ns: int) -> list[RoverMotion]:
        """Readings that are complete with these bytes, oldest first.

        Args:
            wall_ns: monotonic time of their arrival.
        """
        readings: list[RoverMotion] = []
        before = self._lines.too_long
        for line in self._lines.receive(data):
            message = self._parsed(line)
            if message is not None and (reading := self._take(message, wall_ns)) is not None:
                readings.append(reading)
        self.bad += self._lines.too_long - before
        return readings

    def _parsed(self, line: bytes) -> NMEAMessage | None:
        """A sentence; None for one that is of no use, or damaged."""
        if _SENTENCE.fullmatch(line) is None:
            known = line[3:6] in (b"RMC", b"HDT", b"ROT", b"GGA")
            self.bad += bool(line) and (known or _OTHER.fullmatch(line) is None)
            return None
        try:
            return NMEAReader.parse(line + b"\r\n")  # it checks the sum
        except (NMEAParseError, NMEAMessageError, NMEATypeError, ValueError, TypeError, IndexError, KeyError):
            self.bad += 1
            return None

    def _take(self, message: NMEAMessage, wall_ns: int) -> RoverMotion | None:
        """Take in a sentence; an RMC makes a reading, with the newest heading."""
        kind = message.msgID
        if kind == "HDT":
            if (heading_deg := _number(message, "headingT", 0.0, 360.0)) is not None:
                self._on_heading(wrap_pi(radians(heading_deg)), wall_ns)
        elif kind == "ROT":
            limit = YAW_RATE_MAX_RPS / DEGREE_PER_MINUTE_RPS
            turn = _number(message, "rot", -limit, limit) if message.valid == "A" else None
            self._turn_rps = None if turn is None else (wall_ns, turn * DEGREE_PER_MINUTE_RPS)
        elif kind == "GGA":
            self._quality = int(_number(message, "quality", 0, 9) or 0)
        else:
            return self._reading(message, wall_ns)
        return None

    def _on_heading(self, yaw_rad: float, wall_ns: int) -> None:
        turned = self._turned
        if self._heading is None or wall_ns - self._heading[0] > TURN_WINDOW_NS:
            turned.clear()
        last_rad = turned[-1][1] if turned else yaw_rad
        turned.append((wall_ns, last_rad + wrap_pi(yaw_rad - last_rad)))
        while wall_ns - turned[0][0] > TURN_WINDOW_NS:
            turned.popleft()
        self._heading = (wall_ns, yaw_rad)

    def _reading(self, rmc: NMEAMessage, wall_ns: int) -> RoverMotion | None:
        speed_kn = _number(rmc, "spd", 0.0, SPEED_MAX_MPS / KNOT_MPS)
        if rmc.status != "A" or self._quality == 0 or speed_kn is None:
            self.problem = "the rover's receiver has no fix"
            return None
        if self._heading is None or wall_ns - self._heading[0] > HEADING_MAX_AGE_NS:
            self.problem = "the rover's receiver sends no heading (HDT): are both antennas connected?"
            return None
        self.problem = ""
        yaw_rad, course_deg = self._heading[1], _number(rmc, "cog", 0.0, 360.0)
        backwards = course_deg is not None and cos(radians(course_deg) - yaw_rad) < 0.0
        speed_mps = speed_kn * KNOT_MPS
        return RoverMotion(yaw_rad, -speed_mps if backwards else speed_mps, self._yaw_rate_rps(wall_ns))

    def _yaw_rate_rps(self, wall_ns: int) -> float:
        if self._turn_rps is not None and wall_ns - self._turn_rps[0] <= HEADING_MAX_AGE_NS:
            return self._turn_rps[1]
        (first_ns, first_rad), (last_ns, last_rad) = self._turned[0], self._turned[-1]
        if last_ns - first_ns < TURN_WINDOW_NS // 2:
            return 0.0
        rate_rps = (last_rad - first_rad) * NS_PER_S / (last_ns - first_ns)
        return max(-YAW_RATE_MAX_RPS, min(YAW_RATE_MAX_RPS, rate_rps))


def _number(message: NMEAMessage, name: str, lowest: float, highest: float) -> float | None:
    """A field of a sentence; None where it is empty, or no such number."""
    value = getattr(message, name, None)
    if isinstance(value, str) or not isinstance(value, int | float):
        return None
    return float(value) if lowest <= value <= highest else None
