"""The driver of a real rover: publishes its odometry, and sends it the drive commands of the bus."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import cos, sin
from typing import Protocol

import msgspec

from jezero.runtime.service import Health, Inbox, Output, Publish, Send, Spec
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.topics import ROVER_COMMAND, ROVER_ODOMETRY
from jezero.schemas.units import NS_PER_S
from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.json_lines import OdometryLines
from jezero.services.rover_driver.motion import RoverMotion
from jezero.services.rover_driver.nmea import Nmea

ODOMETRY_LINK, COMMAND_LINK = "odometry", "commands"
SILENCE_NS = 2_000_000_000
HEALTH_PERIOD_NS = 1_000_000_000
RECKONED_MAX_S = 1.0
"""A longer time without a reading is not reckoned over."""

SPEC = Spec(
    name="rover_driver",
    inputs=(ROVER_COMMAND,),
    outputs=(ROVER_ODOMETRY,),
    links=(ODOMETRY_LINK, COMMAND_LINK),
    triggers=(ODOMETRY_LINK, ROVER_COMMAND.name),
)


class _Parser(Protocol):
    """Reads one format over one connection; it takes any bytes and never raises."""

    @property
    def bad(self) -> int: ...
    @property
    def problem(self) -> str: ...
    def receive(self, data: bytes, wall_ns: int) -> list[RoverMotion]: ...


class RealRover:
    """Publishes `rover/odometry` from a line, and sends `rover/command` on a line.

    Args:
        config: the lines, and what they speak.
    """

    def __init__(self, config: RoverDriverConfig) -> None:
        links = used_links(config)
        triggers = tuple(each for each in SPEC.triggers if each in links or each == ROVER_COMMAND.name)
        self.spec = replace(SPEC, links=links, triggers=triggers, made_with={"config": config})
        self._config = config
        self._delay_ns = round(config.delay_s * NS_PER_S)
        self._command_link = ODOMETRY_LINK if config.command_link == config.link else COMMAND_LINK
        self._parser = self._new_parser()
        self._connections = 0
        self._drive = DriveCommands()
        self._pos_odom_m = (0.0, 0.0)
        self._read_ns: int | None = None
        self._bytes_ns = -SILENCE_NS
        self._readings = 0
        self._judged_ns: int | None = None
        self._health: Health | None = None

    def _new_parser(self) -> _Parser:
        return Nmea() if self._config.format == "nmea" else OdometryLines(self._config)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Publish the newest reading that has arrived, and send the drive commands that are due."""
        if not self.spec.links:
            if self._health is None:
                self._health = Health("ok", "not configured: there is no real rover, see link in rover_driver.toml")
                yield self._health
            return
        if self._config.link:
            yield from self._read(t_ns, inbox)
        if self._config.command_link and inbox.is_up(self._command_link):
            data = self._drive.due(t_ns, inbox.wall_ns, inbox.new(ROVER_COMMAND))
            if data:
                yield Send(self._command_link, data)
        health = self._judged(t_ns, inbox)
        if health is not None and health != self._health:
            self._health = health
            yield health

    def _read(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        if inbox.connections(ODOMETRY_LINK) != self._connections:  # what the lost connection has begun is not continued
            self._connections = inbox.connections(ODOMETRY_LINK)
            self._parser = self._new_parser()
        if data := inbox.received(ODOMETRY_LINK):
            self._bytes_ns = inbox.wall_ns
            readings = self._parser.receive(data, inbox.wall_ns)
            if readings and t_ns > self._delay_ns:
                yield Publish(ROVER_ODOMETRY, self._odometry(t_ns - self._delay_ns, inbox.wall_ns, readings))

    def _odometry(self, t_ns: int, wall_ns: int, readings: Sequence[RoverMotion]) -> RoverOdometry:
        """The newest of the readings that arrived at once, with the place that is dead reckoned."""
        self._readings += 1
        newest = readings[-1]
        passed_s = 0.0 if self._read_ns is None else (wall_ns - self._read_ns) / NS_PER_S
        self._read_ns = wall_ns
        step_m = newest.speed_mps * passed_s if passed_s <= RECKONED_MAX_S else 0.0
        north_m, east_m = self._pos_odom_m
        self._pos_odom_m = (north_m + step_m * cos(newest.yaw_rad), east_m + step_m * sin(newest.yaw_rad))
        return RoverOdometry(
            t_ns=t_ns,
            pos_odom_m=self._pos_odom_m,
            yaw_rover_rad=newest.yaw_rad,
            speed_rover_body_mps=newest.speed_mps,
            yaw_rate_rover_rps=newest.yaw_rate_rps,
            roll_rover_rad=newest.roll_rad,
            pitch_rover_rad=newest.pitch_rad,
        )

    def _judged(self, t_ns: int, inbox: Inbox) -> Health | None:
        """The driver's health; None while the last is young."""
        wall_ns = inbox.wall_ns
        if self._judged_ns is not None and wall_ns - self._judged_ns < HEALTH_PERIOD_NS:
            return None
        passed_s = (wall_ns - self._judged_ns) / NS_PER_S if self._judged_ns is not None else 1.0
        rate_hz, self._readings = self._readings / passed_s, 0
        self._judged_ns = wall_ns
        problem = self._problem(t_ns, inbox)
        text = problem or (f"{rate_hz:.0f} readings/s" if self._config.link else "drive commands go to the rover")
        if self._parser.bad:
            text += f"; {self._parser.bad} damaged lines"
        return Health("degraded" if problem else "ok", text)

    def _problem(self, t_ns: int, inbox: Inbox) -> str:
        """What is wrong, for people; "" for nothing."""
        config, wall_ns = self._config, inbox.wall_ns
        for name, address in ((ODOMETRY_LINK, config.link), (self._command_link, config.command_link)):
            if address and not inbox.is_up(name):
                return f"the line to the rover, {address}, is not open: is it plugged in? The log has the reason"
        if t_ns == 0:
            return "no vehicle time yet"
        if not config.link:
            return ""
        if wall_ns - self._bytes_ns > SILENCE_NS:
            return f"nothing comes from the rover at {config.link}: is it switched on, and is its baud rate right?"
        if self._read_ns is None or wall_ns - self._read_ns > SILENCE_NS:
            lacking = f"check format and baud rate in rover_driver.toml, {config.format} is expected"
            return f"no odometry from {config.link}: {self._parser.problem or lacking}"
        return self._parser.problem


def used_links(config: RoverDriverConfig) -> tuple[str, ...]:
    """Names of the links that the settings use."""
    links = (ODOMETRY_LINK,) if config.link else ()
    own = config.command_link and config.command_link != config.link
    return (*links, COMMAND_LINK) if own else links


# -- drive commands --------------------------------------------------------------------------------------

AGE_MAX_NS = 300_000_000
LEAD_MAX_NS = 50_000_000
"""Clocks of two processes agree to this, so a command may arrive this much before its time stamp."""
TIMEOUT_NS = NS_PER_S // 2
"""The rover stops after this time without a command. Source: `RoverCommand`."""
STOP_PERIOD_NS = NS_PER_S // 2
"""The stop is sent again and again, as a line may lose it."""


class DriveCommands:
    """Drive commands on their way to the rover, which stops when none comes: the newest, and the lines that are due."""

    def __init__(self) -> None:
        self._newest_ns = -AGE_MAX_NS
        self._commanded_ns: int | None = None
        """Time of arrival of the last command; None while the rover stands."""
        self._stopped_ns: int | None = None

    def due(self, t_ns: int, wall_ns: int, commands: Sequence[RoverCommand]) -> bytes:
        """Lines to send now.

        Args:
            t_ns: vehicle time, in which the commands are stamped.
            wall_ns: monotonic time, by which the rover stops: vehicle time may stand still.
            commands: those that arrived; old ones, and ones that overtook each other, are dropped.
        """
        data = b""
        for command in commands:
            if command.t_ns >= self._newest_ns and -LEAD_MAX_NS <= t_ns - command.t_ns <= AGE_MAX_NS:
                self._newest_ns, self._commanded_ns, self._stopped_ns = command.t_ns, wall_ns, None
                data = line_of(command.speed_rover_body_mps, command.yaw_rate_rover_rps)
        if self._commanded_ns is not None and wall_ns - self._commanded_ns > TIMEOUT_NS:
            self._commanded_ns = None
        if self._commanded_ns is None:
            self._newest_ns = min(self._newest_ns, t_ns)  # a new epoch may begin earlier
            if self._stopped_ns is None or wall_ns - self._stopped_ns >= STOP_PERIOD_NS:
                self._stopped_ns = wall_ns
                data += line_of(0.0, 0.0)
        return data


def line_of(speed_mps: float, yaw_rate_rps: float) -> bytes:
    """A drive command as a line."""
    return msgspec.json.encode({"speed_mps": speed_mps, "yaw_rate_rps": yaw_rate_rps}) + b"\n"
