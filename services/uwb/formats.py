"""What the UWB modules speak: bytes in, ranges by the modules' ids out. A parser takes any bytes and never raises."""

from collections.abc import Callable, Mapping
from typing import Protocol

from jezero.services.uwb.config import Format
from jezero.services.uwb.dwm1001 import Dwm1001
from jezero.services.uwb.json_lines import RangeLines
from jezero.services.uwb.nooploop import Nooploop

Round = dict[str, float]
"""Range in metres by the id of the anchor's module, in capitals, from one round of measurements."""


class Parser(Protocol):
    """Reads one format over one connection."""

    @property
    def bad(self) -> int:
        """Number of lines or frames so far that were damaged."""

    def receive(self, data: bytes) -> list[Round]:
        """Rounds that are complete with these bytes, oldest first."""

    def due(self, wall_ns: int) -> bytes:
        """Bytes to send to the module now, to make it send ranges; call it after each `receive`.

        Args:
            wall_ns: monotonic time.
        """


PARSERS: Mapping[Format, Callable[[], Parser]] = {"dwm1001": Dwm1001, "nooploop": Nooploop, "json": RangeLines}


def parser_of(kind: Format) -> Parser:
    """A parser for a new connection."""
    return PARSERS[kind]()
