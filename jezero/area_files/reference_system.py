"""Latitude and longitude from the coordinates of other reference systems, such as UTM; by PROJ."""

from collections.abc import Callable
from math import isfinite

from jezero.area_files.polygon import AreaFileError, Corner, excerpt

WGS_84 = ("urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:OGC::CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4326")
"""Names that GeoJSON files give to longitude and latitude on WGS 84."""
WGS_84_WKT = ('GEOGCS["GCS_WGS_1984"', 'GEOGCS["WGS 84"')
"""How the description of the same begins in shapefiles."""


Convert = Callable[[float, float], Corner]
"""Function from a file's first two coordinates to a corner."""


def degrees_from(system: str) -> Convert:
    """Function from easting and northing, or longitude and latitude, to latitude and longitude on WGS 84.

    Args:
        system: name of the reference system, such as "EPSG:32632", or its description as WKT.

    Raises:
        AreaFileError: the system is not known, or pyproj is not installed. The function raises it for coordinates that
            are outside the system.
    """
    if system in WGS_84 or system.startswith(WGS_84_WKT):
        return lambda longitude_deg, latitude_deg: (latitude_deg, longitude_deg)
    try:
        from pyproj import Transformer
        from pyproj.exceptions import CRSError, ProjError
    except ModuleNotFoundError:
        raise AreaFileError(
            "its coordinate system must be converted by pyproj, which is an extra: pip install 'jezero[gis]', or "
            "export the file as WGS 84 (EPSG:4326)"
        ) from None
    try:
        transformer = Transformer.from_crs(system, "EPSG:4326", always_xy=True)
    except (CRSError, ProjError, ValueError):
        raise AreaFileError(
            f'its coordinate system "{excerpt(system)}" is not known: export the file as WGS 84 (EPSG:4326)'
        ) from None

    def convert(east: float, north: float) -> Corner:
        longitude_deg, latitude_deg = transformer.transform(east, north)
        if not (isfinite(longitude_deg) and isfinite(latitude_deg)):
            raise AreaFileError(f'{east:g}, {north:g} is outside its coordinate system "{excerpt(system)}"')
        return float(latitude_deg), float(longitude_deg)

    return convert
