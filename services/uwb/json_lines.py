"""Ranges as JSON, one object a line: `{"ranges_m": {"022E": 3.44, "1A2B": 5.01}}`. For modules with own firmware."""

from typing import Annotated

import msgspec

from jezero.base.lines import Lines

ModuleId = Annotated[str, msgspec.Meta(min_length=1, max_length=32)]
Range = Annotated[float, msgspec.Meta(ge=0.0, le=1e4)]


class _Line(msgspec.Struct):
    """Other fields are ignored."""

    ranges_m: Annotated[dict[ModuleId, Range], msgspec.Meta(max_length=64)]


class RangeLines:
    """Reads the lines; the module sends by itself.

    Attributes:
        bad: number of lines that were damaged.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._lines = Lines()
        self._decoder = msgspec.json.Decoder(_Line)

    def receive(self, data: bytes) -> list[dict[str, float]]:
        """Rounds that are complete with these bytes, oldest first."""
        before = self._lines.too_long
        rounds: list[dict[str, float]] = []
        for line in self._lines.receive(data):
            try:
                found = self._decoder.decode(line) if line else _Line({})
            except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):  # deep nesting exhausts the stack
                self.bad += 1
                continue
            if found.ranges_m:
                rounds.append({module.upper(): range_m for module, range_m in found.ranges_m.items()})
        self.bad += self._lines.too_long - before
        return rounds

    def due(self, wall_ns: int) -> bytes:
        """Nothing: the module sends by itself."""
        return b""
