"""Files of a map for viewers and geographic information systems (GIS).

| file | content |
|---|---|
| `.png` | the map, transparent where no image shows the ground |
| `.pgw`, `.prj` | the PNG's world file in metres of the world frame, east and north, and its projection |
| `.tif` | GeoTIFF in degrees (EPSG:4326) |
| `.kml` | the PNG as an overlay for Google Earth and others |

The last three need the position of the world frame's origin. Metres of the world frame are degrees times a constant on
each axis (`geodetic_from_ned`), so a map's rows and columns are straight in both.
"""

from math import cos, radians
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import cv2
import numpy as np

from jezero.base.files import naming
from jezero.base.frames import EARTH_RADIUS_M, Vec3, geodetic_from_ned

if TYPE_CHECKING:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    from jezero.mapping.mosaic import Mosaic

IMAGE_DESCRIPTION, MODEL_PIXEL_SCALE, MODEL_TIEPOINT, GEO_KEYS = 270, 33550, 33922, 34735
ASCII, SHORT, DOUBLE = 2, 3, 12
"""TIFF's types."""
GEOGRAPHIC, PIXEL_IS_AREA, WGS84, DEGREE = 2, 1, 4326, 9102


def save_map(mosaic: "Mosaic", origin_deg: Vec3 | None, description: str, file: Path) -> list[Path]:
    """Write a map's files; those in degrees only with an origin.

    Args:
        origin_deg: latitude, longitude and altitude of the world frame's origin.
        description: text for people in the files' metadata.
        file: the PNG; the others are beside it, with the same name.

    Returns:
        The files written, the PNG first.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    picture = np.dstack((mosaic.pixels[:, :, ::-1], np.where(mosaic.seen, 255, 0).astype(np.uint8)))
    _, encoded = cv2.imencode(".png", picture)
    numbers = (mosaic.m_per_px, 0.0, 0.0, -mosaic.m_per_px, mosaic.east_m, mosaic.north_m)
    contents: dict[Path, bytes] = {
        file: encoded.tobytes(),
        file.with_suffix(".pgw"): "".join(f"{number:.6f}\n" for number in numbers).encode(),
    }
    if origin_deg is not None:
        contents[file.with_suffix(".prj")] = projection_wkt(origin_deg).encode()
        contents[file.with_suffix(".kml")] = _kml(file.name, description, _edges_deg(mosaic, origin_deg)).encode()
    for path, data in contents.items():
        with naming(path):
            path.write_bytes(data)
    written = list(contents)
    if origin_deg is not None:
        written.append(_save_tiff(mosaic, origin_deg, description, file.with_suffix(".tif")))
    return written


def projection_wkt(origin_deg: Vec3) -> str:
    """The world frame's metres as a projection, in ESRI's WKT: the azimuthal equidistant one of a sphere.

    GIS takes latitude and longitude of the sphere for those of WGS84, as autopilots do.
    """
    latitude, longitude, _ = origin_deg
    return (
        'PROJCS["jezero_world",GEOGCS["GCS_Sphere",'
        f'DATUM["D_Sphere",SPHEROID["Sphere",{EARTH_RADIUS_M:.1f},0.0]],'
        'PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Azimuthal_Equidistant"],'
        'PARAMETER["False_Easting",0.0],PARAMETER["False_Northing",0.0],'
        f'PARAMETER["Central_Meridian",{longitude:.10f}],PARAMETER["Latitude_Of_Origin",{latitude:.10f}],'
        'UNIT["Meter",1.0]]\n'
    )


def _edges_deg(mosaic: "Mosaic", origin_deg: Vec3) -> tuple[float, float, float, float]:
    """North, south, east and west edges of the first and last pixels."""
    rows, columns = mosaic.seen.shape
    north_m, west_m = mosaic.north_m + 0.5 * mosaic.m_per_px, mosaic.east_m - 0.5 * mosaic.m_per_px
    south_m, east_m = north_m - mosaic.m_per_px * rows, west_m + mosaic.m_per_px * columns
    north, west, _ = geodetic_from_ned((north_m, west_m, 0.0), origin_deg)
    south, east, _ = geodetic_from_ned((south_m, east_m, 0.0), origin_deg)
    return north, south, east, west


def _save_tiff(mosaic: "Mosaic", origin_deg: Vec3, description: str, path: Path) -> Path:
    from PIL import Image as Pillow

    picture = Pillow.fromarray(np.dstack((mosaic.pixels, np.where(mosaic.seen, 255, 0).astype(np.uint8))))
    with naming(path):
        picture.save(path, compression="tiff_adobe_deflate", tiffinfo=_geo_tags(mosaic, origin_deg, description))
    return path


def _geo_tags(mosaic: "Mosaic", origin_deg: Vec3, description: str) -> "ImageFileDirectory_v2":
    """Source: OGC GeoTIFF 1.1."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    north, south, east, west = _edges_deg(mosaic, origin_deg)
    rows, columns = mosaic.seen.shape
    keys = ((1024, GEOGRAPHIC), (1025, PIXEL_IS_AREA), (2048, WGS84), (2054, DEGREE))
    directory = [number for key, value in keys for number in (key, 0, 1, value)]
    values = {
        IMAGE_DESCRIPTION: (ASCII, description),
        MODEL_PIXEL_SCALE: (DOUBLE, ((east - west) / columns, (north - south) / rows, 0.0)),
        MODEL_TIEPOINT: (DOUBLE, (0.0, 0.0, 0.0, west, north, 0.0)),
        GEO_KEYS: (SHORT, (1, 1, 0, len(keys), *directory)),
    }
    tags = ImageFileDirectory_v2()
    for tag, (kind, value) in values.items():
        tags.tagtype[tag] = kind
        tags[tag] = value
    return tags


def _kml(picture: str, description: str, edges_deg: tuple[float, float, float, float]) -> str:
    north, south, east, west = edges_deg
    middle = f"<longitude>{0.5 * (east + west):.10f}</longitude><latitude>{0.5 * (north + south):.10f}</latitude>"
    range_m = 1.5 * EARTH_RADIUS_M * max(radians(north - south), radians(east - west) * cos(radians(north)))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2">
<GroundOverlay>
  <name>{escape(picture)}</name>
  <description>{escape(description)}</description>
  <LookAt>{middle}<range>{range_m:.1f}</range></LookAt>
  <Icon><href>{escape(picture)}</href></Icon>
  <LatLonBox>
    <north>{north:.10f}</north><south>{south:.10f}</south><east>{east:.10f}</east><west>{west:.10f}</west>
  </LatLonBox>
</GroundOverlay>
</kml>
"""
