"""Driving the rover. It obeys a command for half a second, so whoever drives it commands it all the time."""

import csv
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jezero.client.errors import TimedOut, Unreachable
from jezero.client.session import Arrivals, Connection, decode
from jezero.schemas.commands import RoverCommand
from jezero.schemas.state import Clock
from jezero.schemas.topics import CLOCK, ROVER_COMMAND
from jezero.schemas.units import NS_PER_S

SILENCE_S = 3.0
SPEED_MAX_MPS = 2.0
YAW_RATE_MAX_RPS = 1.0
STOPS = 3
"""Commands to stand that a stop consists of: one may be lost."""
COLUMNS = ("duration_s", "speed_mps", "yaw_rate_rps")


class Leg(NamedTuple):
    """A part of a drive.

    Attributes:
        duration_s: of vehicle time.
        speed_mps: forward, negative is backwards.
        yaw_rate_rps: clockwise as seen from above.
    """

    duration_s: float
    speed_mps: float
    yaw_rate_rps: float


class Rover:
    """The rover of one vehicle; comes with `Vehicle.rover`."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def drive(self, speed_mps: float, yaw_rate_rps: float = 0.0, *, for_s: float | None = None) -> None:
        """Drive for some seconds of vehicle time, or until an exception such as Ctrl+C; then the rover is stopped.

        Args:
            speed_mps: forward, negative is backwards.
            yaw_rate_rps: clockwise as seen from above.

        Raises:
            ValueError: faster than the rover can.
            Unreachable: no simulator or vehicle gives the time.
        """
        self.follow([Leg(math.inf if for_s is None else for_s, speed_mps, yaw_rate_rps)])

    def stop(self) -> None:
        """Stand still; raises as `drive`."""
        with _Ticks(self._connection) as ticks:
            self._stop(ticks)

    def follow(self, legs: Sequence[Leg], tell: Callable[[int, Leg], None] = lambda number, leg: None) -> None:
        """Drive one leg after the other, then stop; raises as `drive`.

        Args:
            tell: called with each leg's number, from 1, when it begins.
        """
        for number, leg in enumerate(legs, start=1):
            if problem := problem_of(leg):
                raise ValueError(f"leg {number}: {problem}")
        with _Ticks(self._connection) as ticks:
            try:
                self._follow(legs, ticks, tell)
            finally:
                self._stop(ticks)

    def _follow(self, legs: Sequence[Leg], ticks: "_Ticks", tell: Callable[[int, Leg], None]) -> None:
        t_ns = next(ticks)
        end_ns: float = t_ns
        for number, leg in enumerate(legs, start=1):
            tell(number, leg)
            end_ns += leg.duration_s * NS_PER_S
            while t_ns < end_ns:
                self._command(t_ns, leg.speed_mps, leg.yaw_rate_rps)
                t_ns = next(ticks)

    def _stop(self, ticks: "_Ticks") -> None:
        for _ in range(STOPS):
            self._command(next(ticks), 0.0, 0.0)

    def _command(self, t_ns: int, speed_mps: float, yaw_rate_rps: float) -> None:
        command = RoverCommand(t_ns=t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=yaw_rate_rps)
        self._connection.publish(ROVER_COMMAND, command)


class _Ticks(Iterator[int]):
    """Vehicle time, ten times a second, as its master tells it: what the vehicle's own clock paces can't be too old."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __enter__(self) -> "_Ticks":
        self._arrivals: Arrivals
        self._arrivals, self._undeclare = self._connection.subscribe(CLOCK)
        return self

    def __exit__(self, *exception: object) -> None:
        self._undeclare()

    def __next__(self) -> int:
        try:
            data = self._arrivals.take(time.monotonic() + SILENCE_S)
        except TimedOut:
            data = None
        if data is None:
            vehicle = self._connection.vehicle
            raise Unreachable(f"no clock of {vehicle} for {SILENCE_S:g} s: is the stack up? (`jezero up`)")
        clock: Clock = decode(Clock, data)
        return clock.t_ns


def problem_of(leg: Leg) -> str:
    """Why the rover can't drive this, or ""."""
    if not leg.duration_s > 0.0:
        return f"duration {leg.duration_s:g} s is not positive"
    if not abs(leg.speed_mps) <= SPEED_MAX_MPS:
        return f"speed {leg.speed_mps:g} m/s is not within ±{SPEED_MAX_MPS:g}"
    if not abs(leg.yaw_rate_rps) <= YAW_RATE_MAX_RPS:
        return f"yaw rate {leg.yaw_rate_rps:g} rad/s is not within ±{YAW_RATE_MAX_RPS:g}"
    return ""


def read_legs(path: Path) -> list[Leg]:
    """Legs from a CSV file whose first line is `duration_s,speed_mps,yaw_rate_rps`.

    Raises:
        ValueError: it is something else; the text says in which line.
    """
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    header = ",".join(COLUMNS)
    if not rows or tuple(cell.strip() for cell in rows[0]) != COLUMNS:
        raise ValueError(f"{path}: the first line must be {header}")
    legs = [_leg(row, f"{path}, line {number}") for number, row in enumerate(rows[1:], start=2) if row]
    if not legs:
        raise ValueError(f"{path} has no line below {header}")
    return legs


def _leg(row: list[str], where: str) -> Leg:
    try:
        duration_s, speed_mps, yaw_rate_rps = (float(cell) for cell in row)
    except ValueError:
        raise ValueError(f"{where}: {','.join(row)!r} is not three numbers") from None
    leg = Leg(duration_s, speed_mps, yaw_rate_rps)
    if problem := problem_of(leg):
        raise ValueError(f"{where}: {problem}")
    if math.isinf(duration_s):
        raise ValueError(f"{where}: a drive that never ends")
    return leg
