"""The modules on lines of their own: they speak what the real ones do, from what the simulated sensors measure."""

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jezero.base.codec import decode
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.base.zenoh_client import client_config, data_of
from jezero.deploy.twin.line import Line
from jezero.runtime.instance import Instance
from jezero.schemas.sensors import Uwb
from jezero.schemas.topics import UWB, key

UWB_DEVICE, UWB_BAUD = "uwb-module", 115_200
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


class Modules:
    """All modules, and the settings of the drivers that read them.

    Args:
        folder: where the devices are made.
    """

    def __init__(self, folder: Path) -> None:
        self.uwb = Dwm1001Shell(folder / UWB_DEVICE)
        anchors = len(load_config(VehicleConfig, "vehicle").uwb.pos_anchors_rover_body_m)
        ids = ", ".join(f'"{each}"' for each in module_ids(anchors))
        self.settings = (
            ("uwb", "", "link", f'"serial:{self.uwb.line.path}:{UWB_BAUD}"'),
            ("uwb", "", "format", '"dwm1001"'),
            ("vehicle", "uwb", "id_anchors", f"[{ids}]"),
        )
        """File, table, field and value."""
        self.devices = {"UWB module": f"serial:{self.uwb.line.path}:{UWB_BAUD}"}

    def turn(self, now_s: float) -> None:
        """Move all lines; `now_s` is monotonic time."""
        self.uwb.turn(now_s)

    def close(self) -> None:
        """Remove the devices."""
        self.uwb.line.close()


@contextmanager
def running_modules(folder: Path, instance: Instance) -> Iterator[Modules]:
    """Modules that get what the simulator of this instance measures, until the context ends."""
    import zenoh

    modules = Modules(folder)
    try:
        with zenoh.open(client_config(instance.router)) as session:
            session.declare_subscriber(
                key(instance.vehicle, UWB.name), lambda sample: modules.uwb.rounds.append(decode(Uwb, data_of(sample)))
            )
            yield modules
    finally:
        modules.close()
