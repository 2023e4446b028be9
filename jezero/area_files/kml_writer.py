"""KML and KMZ of areas, for Google Earth and QGroundControl."""

import zipfile
from collections.abc import Sequence
from io import BytesIO
from xml.sax.saxutils import escape

from jezero.area_files.polygon import FilePolygon, Ring

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>\n'


def kml_of(polygons: Sequence[FilePolygon]) -> bytes:
    """A KML document with a placemark for each polygon; they are in degrees."""
    return (HEAD + "".join(map(_placemark, polygons)) + "</Document>\n</kml>\n").encode()


def kmz_of(polygons: Sequence[FilePolygon]) -> bytes:
    """The same, in the ZIP archive that Google Earth reads."""
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("doc.kml", kml_of(polygons))
    return archive.getvalue()


def _placemark(polygon: FilePolygon) -> str:
    outline, *holes = polygon.rings
    inner = "".join(f"<innerBoundaryIs>{_ring(hole)}</innerBoundaryIs>" for hole in holes)
    shape = f"<Polygon><outerBoundaryIs>{_ring(outline)}</outerBoundaryIs>{inner}</Polygon>"
    return f"<Placemark><name>{escape(polygon.name)}</name>{shape}</Placemark>\n"


def _ring(ring: Ring) -> str:
    """Corners as longitude,latitude; the last one repeats the first one."""
    corners = " ".join(f"{longitude:.8f},{latitude:.8f}" for latitude, longitude in (*ring, ring[0]))
    return f"<LinearRing><coordinates>{corners}</coordinates></LinearRing>"
