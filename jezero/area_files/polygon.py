"""What every format of an area file is read into, before the area is placed in the world."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

Corner = tuple[float, float]
"""Latitude and longitude in degrees, or north and east in metres: see `FilePolygon.rings`."""
Ring = tuple[Corner, ...]
"""Corners of an outline or a hole, in their order; the last one doesn't repeat the first one."""


class AreaFileError(ValueError):
    """The file has no area that can be used; the message names the place and what to write instead."""


@dataclass(frozen=True)
class FilePolygon:
    """A polygon with its holes as a file has it.

    Attributes:
        name: name that the file gives it; "" for none.
        place: the file, and where the polygon stands in it, for messages: "field.geojson, feature 2".
        rings: the outline, then the holes. A corner is latitude and longitude in degrees (WGS 84), or with `in_metres`
            metres north and east of the world's origin. The last corner doesn't repeat the first one.
        in_metres: unit of the corners.
        perhaps_metres: the file doesn't say that its numbers are degrees, so they may be metres by mistake.
    """

    name: str
    place: str
    rings: tuple[Ring, ...]
    in_metres: bool = False
    perhaps_metres: bool = False


def ring_from(corners: Sequence[Corner], place: str) -> Ring:
    """A ring without the repetition of its first corner.

    Raises:
        AreaFileError: it has fewer than three corners.
    """
    ring = tuple(corners)
    while len(ring) > 1 and ring[-1] == ring[0]:
        ring = ring[:-1]
    if len(set(ring)) < 3:
        raise AreaFileError(f"{place} has {count(len(set(ring)), 'corner')}, and an area needs three")
    return ring


def number_from(value: Any) -> float | None:
    """A finite number of a JSON file; None for everything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if isfinite(number) else None


def number_in(text: str) -> float | None:
    """The finite number that a text is; None for everything else."""
    try:
        return number_from(float(text)) if "_" not in text else None
    except ValueError:
        return None


def excerpt(value: object, length: int = 60) -> str:
    """A value of a file for a message, on one line and not too long."""
    text = " ".join(str(value).split())
    return text if len(text) <= length else f"{text[:length]}…"


def count(number: int, noun: str) -> str:
    """A number with its noun: "1 corner", "2 corners"."""
    return f"{number} {noun}" + ("" if number == 1 else "s")
