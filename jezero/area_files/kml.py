"""KML, as Google Earth writes it, and KMZ, the same in a ZIP archive."""

import re
import zipfile
import zlib
from collections.abc import Iterator
from html.entities import name2codepoint
from io import BytesIO
from lzma import LZMAError
from typing import TYPE_CHECKING

from jezero.area_files.polygon import AreaFileError, Corner, FilePolygon, excerpt, number_in, ring_from

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

DAMAGES = (zipfile.BadZipFile, zlib.error, LZMAError, EOFError, NotImplementedError, RuntimeError, OSError, ValueError)
"""What `zipfile` raises for damaged archives; a ValueError for a document that would begin before the file."""
DEPTH_MAX = 100
"""Elements within each other; folders within folders are ten deep at most."""
OTHERS = ("Point", "LineString", "Track", "GroundOverlay", "NetworkLink")
"""Elements that are no areas, to say what a file without areas has."""
LETTER, XML_LETTERS = re.compile(rb"&([A-Za-z][A-Za-z0-9]*);"), ("amp", "lt", "gt", "quot", "apos")
"""A name of a letter, and those that XML itself has."""
ROOT = re.compile(
    rb"(?>\s+|\xef\xbb\xbf|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>\[]*>)*+<[A-Za-z][\w.:-]*(?P<attributes>[^>]*)", re.DOTALL
)
"""Everything up to the end of the first tag."""
TAG, PREFIX = re.compile(rb"<[^<>!?]+>"), re.compile(rb"([A-Za-z_][\w.-]*):[\w.-]")
DECLARED = re.compile(rb"xmlns:([\w.-]+)")
"""A tag, prefixes in it (those in a value of an attribute do no harm), and one that is declared."""


def read_kmz(data: bytes, bytes_max: int) -> list[FilePolygon]:
    """Read all polygons of the archive's main document.

    Args:
        bytes_max: size of the document beyond which it is refused.

    Raises:
        AreaFileError: the archive is damaged, or its document has no polygon.
    """
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            names = [name for name in archive.namelist() if name.lower().endswith(".kml")]
            if not names:
                raise AreaFileError("is an archive without a .kml file")
            with archive.open("doc.kml" if "doc.kml" in names else names[0]) as document:
                content = document.read(bytes_max + 1)
    except DAMAGES as error:
        raise AreaFileError(f"is not a KMZ archive that can be read ({excerpt(error)})") from None
    if len(content) > bytes_max:
        raise AreaFileError(f"has a document of more than {bytes_max / 1e6:.0f} MB")
    return read_kml(content)


def read_kml(data: bytes) -> list[FilePolygon]:
    """Read all polygons of all placemarks; a ring that stands alone is a polygon too.

    Prefixes that the file uses without declaring them, and HTML's names of letters such as `&nbsp;`, are no mistakes:
    Google Earth and web pages write them.

    Raises:
        AreaFileError: it is not XML, defines entities (which can grow without bounds), or has no polygon.
    """
    try:
        from defusedxml.ElementTree import ParseError, fromstring
    except ModuleNotFoundError:
        raise AreaFileError("is KML, which needs defusedxml, an extra: pip install 'jezero[cli]'") from None
    try:
        root = fromstring(_repaired(data))
    except (ParseError, ValueError, LookupError) as error:
        raise AreaFileError(f"is not KML that can be read ({excerpt(error) or type(error).__name__})") from None
    _check_depth(root)
    found = []
    for number, placemark in enumerate(_all(root, "Placemark"), 1):
        name = " ".join((_text(placemark, "name")).split())
        shapes = list(_shapes(placemark))
        for index, shape in enumerate(shapes, 1):
            place = f"Placemark {number}" + (f", Polygon {index}" if len(shapes) > 1 else "")
            found.append(FilePolygon(name, place, tuple(_rings(shape, place))))
    if not found:
        others = [kind for kind in OTHERS if next(_all(root, kind), None) is not None]
        has = f": it has {', '.join(others)}" if others else ""
        raise AreaFileError(f"has no Placemark with a Polygon{has}")
    return found


def _repaired(data: bytes) -> bytes:
    """The document with all its prefixes declared, and with numbers in place of HTML's names of letters."""
    data = LETTER.sub(lambda name: _letter(name[0], name[1].decode()), data)
    begin = ROOT.match(data)
    used = {name for tag in TAG.findall(data) for name in PREFIX.findall(tag)}
    if begin is None:
        return data
    missing = sorted(used - {b"xml", b"xmlns", *DECLARED.findall(begin["attributes"])})
    declared = b"".join(b' xmlns:%s="undeclared:%s"' % (prefix, prefix) for prefix in missing)
    at = begin.start("attributes")
    return data[:at] + declared + data[at:]


def _letter(whole: bytes, name: str) -> bytes:
    code = name2codepoint.get(name)
    return whole if code is None or name in XML_LETTERS else b"&#%d;" % code


def _shapes(placemark: "Element") -> Iterator["Element"]:
    """The polygons, and the rings that are no part of one."""
    for element in placemark:
        if _is(element, "Polygon") or _is(element, "LinearRing"):
            yield element
        else:
            yield from _shapes(element)


def _check_depth(root: "Element") -> None:
    """Refuse elements that are nested so deeply that a search at each of them takes for ever.

    Raises:
        AreaFileError: they are.
    """
    level = [root]
    for _ in range(DEPTH_MAX):
        level = [child for element in level for child in element]
    if level:
        raise AreaFileError("is nested too deeply")


def _rings(shape: "Element", place: str) -> Iterator[tuple[Corner, ...]]:
    """The outline, then the holes."""
    if _is(shape, "LinearRing"):
        yield _ring(shape, place)
        return
    outer = [ring for boundary in _children(shape, "outerBoundaryIs") for ring in _children(boundary, "LinearRing")]
    inner = [ring for boundary in _children(shape, "innerBoundaryIs") for ring in _children(boundary, "LinearRing")]
    if len(outer) != 1:
        raise AreaFileError(f"{place} has {len(outer)} outer boundaries instead of one")
    for number, ring in enumerate((outer[0], *inner)):
        here = f"{place}, hole {number}" if number else place
        yield _ring(ring, here)


def _ring(ring: "Element", place: str) -> tuple[Corner, ...]:
    return ring_from([_corner(word, place) for word in _text(ring, "coordinates").split()], place)


def _corner(word: str, place: str) -> Corner:
    numbers = [number_in(part) for part in word.split(",")]
    if len(numbers) not in {2, 3} or numbers[0] is None or numbers[1] is None:
        raise AreaFileError(f'{place}: "{excerpt(word)}" is not longitude,latitude or longitude,latitude,altitude')
    return numbers[1], numbers[0]


def _all(element: "Element", name: str) -> Iterator["Element"]:
    """The elements of a name in any of KML's namespaces, at any depth."""
    return (each for each in element.iter() if _is(each, name))


def _children(element: "Element", name: str) -> Iterator["Element"]:
    return (each for each in element if _is(each, name))


def _is(element: "Element", name: str) -> bool:
    return element.tag.rpartition("}")[2] == name


def _text(element: "Element", name: str) -> str:
    """Text of the first child of a name; "" without one."""
    return next((each.text or "" for each in _children(element, name)), "")
