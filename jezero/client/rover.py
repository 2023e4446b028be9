"""The rover. It follows a command for half a second only, so a drive repeats its command until its end.

`drive` and `follow` block until the drive is over and the rover stands; `driving` drives in a thread of its own
meanwhile.
"""

import csv
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import NamedTuple

from jezero.base.files import NOT_UTF8
from jezero.client.errors import JezeroError, TimedOut, Unreachable
from jezero.client.session import Connection, ReplyArrivals, decode
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.state import Clock
from jezero.schemas.topics import CLOCK, ROVER_COMMAND, ROVER_ODOMETRY
from jezero.schemas.units import NS_PER_S

CLOCK_TIMEOUT_S = 3.0
SPEED_MAX_MPS = 2.0
YAW_RATE_MAX_RPS = 1.0
STOP_COMMANDS = 3
"""Least number of commands with speed 0 that stop the rover, as one may be lost."""
STANDS_MPS, STANDS_RPS = 0.05, 0.05
"""A rover whose odometry is below these stands."""
STOP_TIMEOUT_S = 10.0
"""Longest wait, in vehicle time, for a rover to stand after the first command to stop."""
ODOMETRY_TIMEOUT_S = 1.0
"""A rover that publishes no odometry for this time has none, and isn't waited for."""
WHEEL_TIMEOUT_S = 0.6
"""A wheel that is not turned for this time counts as let go: whoever held it may be gone."""
COLUMNS = ("duration_s", "speed_mps", "yaw_rate_rps")


class Leg(NamedTuple):
    """A part of a drive.

    Attributes:
        duration_s: length in vehicle time.
        speed_mps: forward speed, negative backwards.
        yaw_rate_rps: yaw rate, positive clockwise as seen from above.
    """

    duration_s: float
    speed_mps: float
    yaw_rate_rps: float


class Wheel:
    """A steering wheel with a dead man's switch, for `Rover.steer`. Any thread may turn it."""

    def __init__(self) -> None:
        self._turned = (0.0, 0.0, -math.inf)

    def turn(self, speed_mps: float, yaw_rate_rps: float) -> None:
        """Set speed and yaw rate; to be repeated within `WHEEL_TIMEOUT_S`.

        Raises:
            ValueError: a number is outside its range.
        """
        if refusal := leg_refusal(Leg(WHEEL_TIMEOUT_S, speed_mps, yaw_rate_rps)):
            raise ValueError(refusal)
        self._turned = (speed_mps, yaw_rate_rps, time.monotonic())

    def release(self) -> None:
        """Stop the rover: the wheel is let go."""
        self._turned = (0.0, 0.0, -math.inf)

    @property
    def motion(self) -> tuple[float, float] | None:
        """Speed and yaw rate; None for a wheel that was let go, or not turned for too long."""
        speed_mps, yaw_rate_rps, turned_s = self._turned
        return None if time.monotonic() - turned_s > WHEEL_TIMEOUT_S else (speed_mps, yaw_rate_rps)


class Rover:
    """The rover of one vehicle, the attribute `Vehicle.rover`.

    Any thread may use it, and several may share it; the rover follows the newest command of all.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def drive(self, speed_mps: float, yaw_rate_rps: float = 0.0, *, for_s: float | None = None) -> None:
        """Drive, then stop the rover, also after an exception such as Ctrl+C. Blocks until the rover stands.

        `driving` doesn't block. A rover without odometry is not waited for.

        Args:
            speed_mps: forward speed, -2 to 2, negative backwards.
            yaw_rate_rps: yaw rate, -1 to 1, positive clockwise as seen from above.
            for_s: length of the drive in vehicle time; None drives until an exception.

        Raises:
            ValueError: a number is outside its range.
            Unreachable: no vehicle time is published, or the connection was closed.
            TimedOut: the rover still rolls 10 s after the command to stop.
        """
        self.follow([Leg(math.inf if for_s is None else for_s, speed_mps, yaw_rate_rps)])

    @contextmanager
    def driving(self, speed_mps: float, yaw_rate_rps: float = 0.0) -> Iterator[None]:
        """Drive during a `with` block, in a thread of its own; at the end of the block the rover stands.

        ```python
        with uav.rover.driving(0.5):
            uav.land_on_spot().result()
        ```

        Args:
            speed_mps: forward speed, -2 to 2, negative backwards.
            yaw_rate_rps: yaw rate, -1 to 1, positive clockwise as seen from above.

        Raises:
            ValueError: a number is outside its range.
            Unreachable: at the end of the block: the drive had ended earlier, because no vehicle time was published.
            TimedOut: at the end of the block: the rover still rolls 10 s after the command to stop.
        """
        leg = Leg(math.inf, speed_mps, yaw_rate_rps)
        if refusal := leg_refusal(leg):
            raise ValueError(refusal)
        over = threading.Event()
        failures: list[JezeroError] = []

        def drive() -> None:
            try:
                self._drive([leg], lambda number, leg: None, over)
            except JezeroError as error:
                failures.append(error)

        thread = threading.Thread(target=drive, name="jezero rover", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
        if failures:
            raise failures[0]

    def stop(self) -> None:
        """Stop the rover. Blocks until it stands.

        Raises:
            Unreachable: no vehicle time is published.
            TimedOut: the rover still rolls 10 s after the command to stop.
        """
        with _Clock(self._connection) as clock:
            self._stop(clock)

    def follow(self, legs: Sequence[Leg], on_leg: Callable[[int, Leg], None] = lambda number, leg: None) -> None:
        """Drive legs one after the other, then stop. Blocks until the rover stands.

        Args:
            legs: the legs.
            on_leg: called with the number, from 1, and the leg when each starts.

        Raises:
            ValueError: a number of a leg is outside its range.
            Unreachable: no vehicle time is published, or the connection was closed.
            TimedOut: the rover still rolls 10 s after the command to stop.
        """
        self._drive(legs, on_leg, threading.Event())

    def steer(self, wheel: Wheel) -> None:
        """Drive as a wheel is turned until it is let go, then stop the rover. Blocks until it stands.

        Raises:
            Unreachable: no vehicle time is published, or the connection was closed.
            TimedOut: the rover still rolls 10 s after the command to stop.
        """
        with _Clock(self._connection) as clock:
            try:
                while (motion := wheel.motion) is not None:
                    self._command(next(clock), *motion)
            finally:
                if not self._connection.closed:
                    self._stop(clock)

    def _drive(self, legs: Sequence[Leg], on_leg: Callable[[int, Leg], None], over: threading.Event) -> None:
        """Drive legs until they or `over` end it, then stop; raises the errors of `follow`."""
        for number, leg in enumerate(legs, start=1):
            if refusal := leg_refusal(leg):
                raise ValueError(f"leg {number}: {refusal}")
        with _Clock(self._connection) as clock:
            try:
                self._follow(legs, clock, on_leg, over)
            finally:
                if not self._connection.closed:
                    self._stop(clock)

    def _follow(
        self, legs: Sequence[Leg], clock: "_Clock", on_leg: Callable[[int, Leg], None], over: threading.Event
    ) -> None:
        t_ns = next(clock)
        end_ns: float = t_ns
        for number, leg in enumerate(legs, start=1):
            on_leg(number, leg)
            end_ns += leg.duration_s * NS_PER_S
            while t_ns < end_ns and not over.is_set():
                self._command(t_ns, leg.speed_mps, leg.yaw_rate_rps)
                t_ns = next(clock)

    def _stop(self, clock: "_Clock") -> None:
        """Command speed 0 until the rover stands."""
        arrivals, undeclare = self._connection.subscribe(ROVER_ODOMETRY, 1)
        odometry: RoverOdometry | None = None
        try:
            start_ns = t_ns = next(clock)
            for number in count(1):
                self._command(t_ns, 0.0, 0.0)
                odometry = _newest_odometry(arrivals) or odometry
                waited_s = (t_ns - start_ns) / NS_PER_S
                if number >= STOP_COMMANDS and (
                    _stands(odometry) if odometry is not None else waited_s > ODOMETRY_TIMEOUT_S
                ):
                    return
                if odometry is not None and waited_s > STOP_TIMEOUT_S:
                    raise TimedOut(
                        f"the rover still rolls at {odometry.speed_rover_body_mps:.2f} m/s, {STOP_TIMEOUT_S:g} s after "
                        "the command to stop: does another client drive it?"
                    )
                t_ns = next(clock)
        finally:
            undeclare()

    def _command(self, t_ns: int, speed_mps: float, yaw_rate_rps: float) -> None:
        command = RoverCommand(t_ns=t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=yaw_rate_rps)
        self._connection.publish(ROVER_COMMAND, command)


class _Clock(Iterator[int]):
    """Iterator over the published vehicle time, ten values a second; commands with these times are never too old."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __enter__(self) -> "_Clock":
        self._arrivals: ReplyArrivals
        self._arrivals, self._undeclare = self._connection.subscribe(CLOCK)
        return self

    def __exit__(self, *exception: object) -> None:
        self._undeclare()

    def __next__(self) -> int:
        try:
            data = self._arrivals.take(time.monotonic() + CLOCK_TIMEOUT_S)
        except TimedOut:
            data = None
        if data is None:
            silent = f"no clock of {self._connection.vehicle} for {CLOCK_TIMEOUT_S:g} s: is the stack up? (`jezero up`)"
            raise Unreachable(self._connection.loss_reason() or self._connection.hidden_reason() or silent)
        clock: Clock = decode(Clock, data)
        return clock.t_ns


def _newest_odometry(arrivals: ReplyArrivals) -> RoverOdometry | None:
    """The rover's odometry that has arrived since the last call, or None."""
    try:
        data = arrivals.take(time.monotonic())
    except TimedOut:
        return None
    return None if data is None else decode(RoverOdometry, data)


def _stands(odometry: RoverOdometry) -> bool:
    return abs(odometry.speed_rover_body_mps) < STANDS_MPS and abs(odometry.yaw_rate_rover_rps) < STANDS_RPS


def leg_refusal(leg: Leg) -> str:
    """Why the rover can't drive a leg, or ""."""
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
        ValueError: the file is not valid; the text names the line.
        OSError: the file can't be read.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except UnicodeDecodeError:
        raise ValueError(f"{path} {NOT_UTF8}") from None
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
    if refusal := leg_refusal(leg):
        raise ValueError(f"{where}: {refusal}")
    if math.isinf(duration_s):
        raise ValueError(f"{where}: the duration must be finite")
    return leg
