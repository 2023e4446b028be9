"""The modules on lines of their own: they speak what the real ones do, from what the simulated sensors measure."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from math import degrees
from pathlib import Path
from typing import Annotated

import msgspec

from jezero.base.codec import decode, encode
from jezero.base.config import load_config
from jezero.base.frames import geodetic_from_ned
from jezero.base.lines import Lines
from jezero.base.vehicle_config import VehicleConfig
from jezero.base.zenoh_client import client_config, data_of
from jezero.deploy.twin.line import Line
from jezero.runtime.instance import Instance
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry, Uwb
from jezero.schemas.topics import ROVER_COMMAND, ROVER_ODOMETRY, UWB, key

UWB_DEVICE, UWB_BAUD = "uwb-module", 115_200
RECEIVER_DEVICE, DRIVE_DEVICE, ROVER_BAUD = "rover-receiver", "rover-motors", 115_200
ORIGIN_DEG = (47.397742, 8.545594, 488.0)
FIRST_MODULE = 0xA001
"""Id of the first anchor's module; those of the others follow."""
WAKE_WITHIN_S = 1.0
GREETING = b"\r\n\r\n DWM1001 TWR Real Time Location System\r\n\r\n Help : ? or help\r\n\r\n"
PROMPT = b"dwm> "
WAITING_MAX = 4
"""Rounds that wait for the main loop; older ones are lost."""


def module_ids(count: int) -> list[str]:
    """Ids of the anchors' modules."""
    return [f"{FIRST_MODULE + i:04X}" for i in range(count)]


class Dwm1001Shell:
    """A DWM1001 at the end of a line: its shell, and its lines of ranges.

    Attributes:
        line: the module's end of the line.
        rounds: rounds to be sent; another thread may append to them.
    """

    def __init__(self, path: Path) -> None:
        self.line = Line(path, UWB_BAUD)
        self.rounds: deque[Uwb] = deque(maxlen=WAITING_MAX)
        self._awake = self._sends = False
        self._typed = b""
        self._returned_s = -WAKE_WITHIN_S

    def turn(self, now_s: float) -> None:
        """Pass what is due on the line, and react to it.

        Args:
            now_s: monotonic time.
        """
        for byte in self.line.move(now_s):
            if byte == ord("\r"):
                self._enter(now_s)
            else:
                self._typed = (self._typed + bytes((byte,)))[-20:]
        while self.rounds:
            uwb = self.rounds.popleft()
            if self._sends:
                self.line.put(lec_line(uwb))

    def _enter(self, now_s: float) -> None:
        command, self._typed = self._typed.strip(), b""
        if not self._awake:
            self._awake = now_s - self._returned_s <= WAKE_WITHIN_S
            self._returned_s = now_s
            if self._awake:
                self.line.put(GREETING + PROMPT)
        elif command == b"reset":
            self._awake = self._sends = False
        else:
            self.line.put(command + b"\r\n" + PROMPT)
            if command == b"lec":  # sent again, it stops the lines
                self._sends = not self._sends


def lec_line(uwb: Uwb) -> bytes:
    """A round as the command `lec` shows it: its numbers have two decimals."""
    parts = [f"DIST,{len(uwb.ranges)}"]
    for i, each in enumerate(uwb.ranges):
        place = ",".join(f"{axis:.2f}" for axis in each.pos_anchor_rover_body_m)
        parts.append(f"AN{i},{FIRST_MODULE + each.anchor:04X},{place},{each.range_m:.2f}")
    return ",".join(parts).encode() + b"\r\n"


class RoverReceiver:
    """The rover's GNSS receiver with two antennas at the end of a line, which sends NMEA.

    Attributes:
        line: the receiver's end of the line.
        readings: odometry to be sent; another thread may append to it.
        newest: the last of it, with this computer's time of its arrival in ns; None before.
    """

    def __init__(self, path: Path) -> None:
        self.line = Line(path, ROVER_BAUD)
        self.readings: deque[RoverOdometry] = deque(maxlen=WAITING_MAX)
        self.newest: tuple[RoverOdometry, int] | None = None

    def add(self, odometry: RoverOdometry) -> None:
        """Take in a reading; called in another thread."""
        self.newest = (odometry, time.monotonic_ns())
        self.readings.append(odometry)

    def turn(self, now_s: float) -> None:
        """Pass what is due on the line; `now_s` is monotonic time."""
        self.line.move(now_s)
        while self.readings:
            self.line.put(sentences(self.readings.popleft()))


class RoverDrive:
    """The rover's motor controller at the end of a line, which takes drive commands as JSON.

    Args:
        path: of the device.
        receiver: knows the rover's time.
        publish: publishes a command in the twin.
    """

    def __init__(self, path: Path, receiver: RoverReceiver, publish: Callable[[RoverCommand], None]) -> None:
        self.line = Line(path, ROVER_BAUD)
        self._lines = Lines()
        self._receiver = receiver
        self._publish = publish

    def turn(self, now_s: float) -> None:
        """Pass what is due on the line; `now_s` is monotonic time."""
        for line in self._lines.receive(self.line.move(now_s)):
            newest = self._receiver.newest
            with suppress(msgspec.DecodeError, RecursionError, UnicodeDecodeError):
                command = msgspec.json.decode(line, type=_DriveLine)
                if newest is not None:
                    odometry, then_ns = newest
                    t_ns = odometry.t_ns + int(1e9 * now_s) - then_ns
                    speed_mps, yaw_rate_rps = command.speed_mps, command.yaw_rate_rps
                    self._publish(
                        RoverCommand(t_ns=t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=yaw_rate_rps)
                    )


class _DriveLine(msgspec.Struct):
    speed_mps: Annotated[float, msgspec.Meta(ge=-2.0, le=2.0)]
    yaw_rate_rps: Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]


def sentences(odometry: RoverOdometry) -> bytes:
    """A reading as HDT, GGA and RMC. The course over ground is behind the rover when it drives backwards."""
    heading_deg = degrees(odometry.yaw_rover_rad) % 360.0
    speed_mps = odometry.speed_rover_body_mps
    course_deg = heading_deg if speed_mps >= 0.0 else (heading_deg + 180.0) % 360.0
    latitude_deg, longitude_deg, _ = geodetic_from_ned((*odometry.pos_odom_m, 0.0), ORIGIN_DEG)
    s = odometry.t_ns // 10_000_000
    clock = f"{s // 360_000 % 24:02d}{s // 6000 % 60:02d}{s // 100 % 60:02d}.{s % 100:02d}"
    place = f"{_minutes(latitude_deg, 2)},N,{_minutes(longitude_deg, 3)},E"
    return b"".join(
        (
            _sentence(f"GNHDT,{heading_deg:.2f},T"),
            _sentence(f"GNGGA,{clock},{place},4,20,0.6,488.0,M,47.0,M,1.0,0001"),
            _sentence(f"GNRMC,{clock},A,{place},{abs(speed_mps) * 3600 / 1852:.3f},{course_deg:.2f},010126,,,R,V"),
        )
    )


def _minutes(angle_deg: float, digits: int) -> str:
    """An angle as NMEA has it: degrees and minutes."""
    whole, rest = divmod(angle_deg, 1.0)
    return f"{int(whole):0{digits}d}{60.0 * rest:08.5f}"


def _sentence(text: str) -> bytes:
    check = 0
    for byte in text.encode():
        check ^= byte
    return f"${text}*{check:02X}\r\n".encode()


class Modules:
    """All modules, and the settings of the drivers that read them.

    Args:
        folder: where the devices are made.
        publish: publishes a drive command in the twin.
    """

    def __init__(self, folder: Path, publish: Callable[[RoverCommand], None]) -> None:
        self.uwb = Dwm1001Shell(folder / UWB_DEVICE)
        self.receiver = RoverReceiver(folder / RECEIVER_DEVICE)
        self.drive = RoverDrive(folder / DRIVE_DEVICE, self.receiver, publish)
        anchors = len(load_config(VehicleConfig, "vehicle").uwb.pos_anchors_rover_body_m)
        ids = ", ".join(f'"{each}"' for each in module_ids(anchors))
        self.devices = {
            "UWB module": f"serial:{self.uwb.line.path}:{UWB_BAUD}",
            "rover's receiver": f"serial:{self.receiver.line.path}:{ROVER_BAUD}",
            "rover's motors": f"serial:{self.drive.line.path}:{ROVER_BAUD}",
        }
        """Address by name, for people."""
        uwb, receiver, drive = self.devices.values()
        self.settings = (
            ("rover_driver", "", "link", f'"{receiver}"'),
            ("rover_driver", "", "command_link", f'"{drive}"'),
            ("uwb", "", "link", f'"{uwb}"'),
            ("uwb", "", "format", '"dwm1001"'),
            ("vehicle", "uwb", "id_anchors", f"[{ids}]"),
        )
        """File, table, field and value."""

    def turn(self, now_s: float) -> None:
        """Move all lines; `now_s` is monotonic time."""
        for module in (self.uwb, self.receiver, self.drive):
            module.turn(now_s)

    def close(self) -> None:
        """Remove the devices."""
        for module in (self.uwb, self.receiver, self.drive):
            module.line.close()


@contextmanager
def running_modules(folder: Path, instance: Instance) -> Iterator[Modules]:
    """Modules that get what the simulator of this instance measures, until the context ends."""
    import zenoh

    with zenoh.open(client_config(instance.router)) as session:
        commands = session.declare_publisher(key(instance.vehicle, ROVER_COMMAND.name))
        modules = Modules(folder, lambda command: commands.put(encode(command)))
        try:
            session.declare_subscriber(
                key(instance.vehicle, UWB.name), lambda sample: modules.uwb.rounds.append(decode(Uwb, data_of(sample)))
            )
            session.declare_subscriber(
                key(instance.vehicle, ROVER_ODOMETRY.name),
                lambda sample: modules.receiver.add(decode(RoverOdometry, data_of(sample))),
            )
            yield modules
        finally:
            modules.close()
