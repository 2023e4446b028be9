"""Nooploop's LinkTrack: ranges in the binary frames Node_Frame2 (`55 04`) and Node_Frame3 (`55 05`).

Source: Nooploop NLink protocol. A frame has a fixed part that ends with the number of nodes, then the nodes, then the
sum of all bytes before it, modulo 256. Numbers are little-endian; a distance is a signed integer of 24 bits, in mm.
A module's id is a number from 0 to 255.
"""

from typing import NamedTuple


class _Layout(NamedTuple):
    """Sizes of one kind of frame: of its fixed part, and of a node in it."""

    fixed_bytes: int
    node_bytes: int


HEADER = 0x55
LAYOUTS = {0x04: _Layout(119, 13), 0x05: _Layout(21, 7)}
"""Layout of each kind of frame. The second byte of a frame, its function mark, says which kind it is."""
NODES_MAX = 64
DISTANCE_AT = 2
"""Place of the distance in a node, after its role and its id."""


class Nooploop:
    """Reads the frames; the module sends by itself.

    Attributes:
        bad: number of frames that were damaged.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._rest = b""

    def receive(self, data: bytes) -> list[dict[str, float]]:
        """Rounds that are complete with these bytes, oldest first."""
        rounds: list[dict[str, float]] = []
        data, at = self._rest + data, 0
        while (at := data.find(HEADER, at)) >= 0 and len(data) - at >= 4:
            layout = LAYOUTS.get(data[at + 1])
            length = data[at + 2] | data[at + 3] << 8
            if layout is None or not _is_possible(layout, length):
                at += 1  # a byte of something else
            elif len(data) - at < length:
                break
            elif (found := _round_of(data[at : at + length], layout)) is None:
                self.bad += 1
                at += 1  # a good frame may begin in what looked like this one
            else:
                rounds.append(found)
                at += length
        self._rest = data[at:] if at >= 0 else b""
        return [each for each in rounds if each]

    def due(self, wall_ns: int) -> bytes:
        """Nothing: the module sends by itself."""
        return b""


def _is_possible(layout: _Layout, length: int) -> bool:
    """Whether a frame with a number of nodes has this length."""
    nodes, rest = divmod(length - layout.fixed_bytes - 1, layout.node_bytes)
    return rest == 0 and 0 <= nodes <= NODES_MAX


def _round_of(frame: bytes, layout: _Layout) -> dict[str, float] | None:
    """Ranges of a frame; None for a damaged one."""
    fixed, size = layout
    if sum(frame[:-1]) & 0xFF != frame[-1] or len(frame) != fixed + size * frame[fixed - 1] + 1:
        return None
    found: dict[str, float] = {}
    for at in range(fixed, len(frame) - 1, size):
        start = at + DISTANCE_AT
        distance_mm = int.from_bytes(frame[start : start + 3], "little", signed=True)
        if distance_mm >= 0:
            found[str(frame[at + 1])] = 1e-3 * distance_mm
    return found
