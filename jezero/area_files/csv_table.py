"""Tables of corners: a line for each corner, and an empty line before each hole."""

import csv
import re
from dataclasses import dataclass

from jezero.area_files.polygon import AreaFileError, Corner, FilePolygon, excerpt, number_in, ring_from
from jezero.base.files import NOT_UTF8

HEADINGS = {
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "long", "lon", "lng"),
    "north": ("north",),
    "east": ("east",),
    "x": ("x",),
    "y": ("y",),
}
"""Quantities, and the headings that name their columns, with or without a unit: `lat`, `latitude_deg`, `north (m)`."""
UNIT = r"(?:[ _]*[\[(]?(?:deg|degrees|°|m|metres|meters|wgs ?84)[\])]?)?"
SEPARATOR_LINE = re.compile(r'"?sep=([;,\t|])"?')
"""First line of tables for Excel: what separates the columns."""
DEGREES, METRES, MAP = ("latitude", "longitude"), ("north", "east"), ("y", "x")
EXPECTED = 'write "latitude,longitude" or "longitude,latitude" for degrees, "north,east" or "east,north" for metres'


@dataclass(frozen=True)
class Columns:
    """The columns of the two coordinates.

    Attributes:
        indices: column of the latitude or of north, then that of the longitude or of east.
        number: number of columns.
        in_metres: unit of both.
        names: both, for messages.
        perhaps_metres: the headings don't say that the numbers are degrees.
    """

    indices: tuple[int, int]
    number: int
    in_metres: bool
    names: str
    perhaps_metres: bool = False


def read_csv(data: bytes, *, metres: bool) -> list[FilePolygon]:
    """Read the one polygon of a table.

    The columns are those that the headings name. Without headings there are two, which are metres north and east.

    Args:
        metres: the coordinates are metres, which a table without headings needs.

    Raises:
        AreaFileError: a line is not understood.
    """
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise AreaFileError(NOT_UTF8) from None
    named = SEPARATOR_LINE.fullmatch(lines[0].strip(" ")) if lines else None
    if named:  # Excel writes it, and doesn't show it
        lines[0] = ""
    separator = named[1] if named else _separator(next((line for line in lines if line.strip()), ""))
    columns: Columns | None = None
    rings: list[list[Corner]] = [[]]
    for number, line in enumerate(lines, 1):
        words = _words(line, separator)
        if not any(words):
            rings.append([])
        elif columns is None and not all(number_in(word) is not None for word in words if word):
            columns = _named_columns(words, f'line {number}: "{excerpt(line)}"', metres)
        else:
            columns = columns or _two_columns(f'line {number}: "{excerpt(line)}"', metres)
            rings[-1].append(_corner(words, columns, f'line {number}: "{excerpt(line)}"'))
    filled = [ring for ring in rings if ring]
    if columns is None or not filled:
        raise AreaFileError("has no corners")
    places = ["the outline"]
    if len(filled) > 1:  # an empty line may be there by mistake
        places = ["the outline, up to the empty line,"]
        places += [f"hole {number}, after an empty line," for number in range(1, len(filled))]
    shape = tuple(ring_from(ring, place) for ring, place in zip(filled, places, strict=True))
    return [FilePolygon("", "the outline", shape, columns.in_metres, columns.perhaps_metres)]


def _separator(line: str) -> str:
    """What separates the numbers of a line; " " for any blanks."""
    return next((separator for separator in (";", "\t", ",") if separator in line.strip()), " ")


def _words(line: str, separator: str) -> list[str]:
    """The words of a line; a table with semicolons may have decimal commas."""
    if separator == " ":
        return line.split()
    try:
        words = [word.strip() for word in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return [line]
    return [word.replace(",", ".") for word in words] if separator == ";" else words


def _two_columns(line: str, metres: bool) -> Columns:
    if not metres:
        raise AreaFileError(
            f"{line} has no headings above it that say what its numbers are: {EXPECTED}; or add --metres for "
            "metres, north and east"
        )
    return Columns((0, 1), 2, True, "north and east")


def _named_columns(words: list[str], line: str, metres: bool) -> Columns:
    """The columns that a line of headings names."""
    found: dict[str, int] = {}
    for index, word in enumerate(words):
        for quantity, headings in HEADINGS.items():
            if re.fullmatch(f"(?:{'|'.join(headings)}){UNIT}", word.lower()):
                if quantity in found:
                    raise AreaFileError(f"{line} has two columns for {quantity}: leave one of them out")
                found[quantity] = index
    pairs = [pair for pair in (DEGREES, METRES, MAP) if all(quantity in found for quantity in pair)]
    if not pairs:
        raise AreaFileError(f"{line} is neither two numbers nor a line of headings: {EXPECTED}")
    if pairs[0] != METRES and metres:
        if pairs[0] == MAP:
            raise AreaFileError(f'{line} doesn\'t say which column is north: write "east,north" or "north,east"')
        raise AreaFileError(f"{line} names degrees: leave out --metres")
    first, second = pairs[0]
    names = f"{first} and {second}"
    return Columns((found[first], found[second]), len(words), pairs[0] == METRES, names, pairs[0] == MAP)


def _corner(words: list[str], columns: Columns, line: str) -> Corner:
    while len(words) > columns.number and not words[-1]:
        words = words[:-1]
    if len(words) == columns.number:
        first, second = (number_in(words[index]) for index in columns.indices)
        if first is not None and second is not None:
            return first, second
    raise AreaFileError(f"{line} is not {columns.number} columns with numbers for {columns.names}")
