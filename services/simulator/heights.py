"""Heights of a real place, from a GeoTIFF of one's own."""

import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt

from jezero.base.config import ConfigError, settings_path
from jezero.base.files import describe_os_error

PIXELS_MAX = 80_000_000
PIXEL_SCALE, TIE_POINT, TRANSFORMATION, GEO_KEYS, NO_DATA = 33550, 33922, 34264, 34735, 42113
"""Tags of a GeoTIFF, and GDAL's of the value that stands for no height. Source: OGC GeoTIFF 1.1."""
MODEL_TYPE_KEY, PROJECTED = 1024, 1
LINEAR_UNIT_KEY, METRE = 3076, 9001
Field = npt.NDArray[np.float64]


def read_heights(file: str, middle_m: tuple[float, float], axis_m: Field) -> Field:
    """Heights over a square grid, positive up, relative to that at the grid's middle.

    Args:
        file: path of a GeoTIFF with one band of heights in metres, north at its top and its pixels in metres; a
            relative path begins in the folder of the settings.
        middle_m: north and east position of the grid's middle, from the middle of the picture.
        axis_m: coordinates of the grid's rows to the north, and of its columns to the east.

    Raises:
        ConfigError: the file can't be used, with the reason.
    """
    path = settings_path(file)
    try:
        heights_m, pixel_m = _read(path)
    except OSError as error:
        reason = describe_os_error(error) if error.errno else f"{path} is no GeoTIFF that can be read: {error}"
        raise ConfigError(f"heights in simulator.toml: {reason}") from None
    except ValueError as error:
        raise ConfigError(f"heights in simulator.toml: {path} {error}") from None
    rows, columns = heights_m.shape
    row = 0.5 * (rows - 1) - (middle_m[0] + axis_m) / pixel_m[0]
    column = 0.5 * (columns - 1) + (middle_m[1] + axis_m) / pixel_m[1]
    if min(row.min(), column.min()) < 0.0 or row.max() > rows - 1 or column.max() > columns - 1:
        size_m = float(axis_m[-1] - axis_m[0])
        raise ConfigError(
            f"heights in simulator.toml: {path} covers {rows * pixel_m[0]:.0f} m to the north and "
            f"{columns * pixel_m[1]:.0f} m to the east, and the terrain's square of {size_m:g} m reaches beyond it: "
            "change heights_north_m and heights_east_m, or take a larger cut"
        )
    found = _bilinear(heights_m, row, column)
    if not np.isfinite(found).all():
        part = 100.0 * float(np.mean(~np.isfinite(found)))
        raise ConfigError(
            f"heights in simulator.toml: {path} has no heights at {part:.1f} % of the terrain: fill the gaps, or "
            "change heights_north_m and heights_east_m"
        )
    middle = len(axis_m) // 2
    found -= float(found[middle - 1 : middle + 1, middle - 1 : middle + 1].mean())
    return found


def _read(path: Path) -> tuple[Field, tuple[float, float]]:
    """Heights with their gaps as NaN, rows to the south, and the size of a pixel to the south and to the east.

    Raises:
        OSError: it can't be read, or is no picture.
        ValueError: the picture is no map of heights in metres.
    """
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        picture = Image.open(path, formats=("TIFF",))
    with picture:
        tags = dict(picture.tag_v2)  # type: ignore[attr-defined]
        if picture.width * picture.height > PIXELS_MAX:
            raise ValueError(f"has {picture.width} x {picture.height} pixels: cut out less than {PIXELS_MAX:.0e}")
        if len(picture.getbands()) != 1 or picture.mode == "P":
            raise ValueError("is a picture in colours: one band of heights is needed")
        pixel_m = _pixel_m(tags)
        heights_m = np.array(picture, dtype=np.float64)
    if NO_DATA in tags:
        heights_m[heights_m == float(str(tags[NO_DATA]).strip("\0 "))] = np.nan
    heights_m[np.abs(heights_m) > 1e5] = np.nan  # such as -3.4e38, of files that don't say so
    return heights_m, pixel_m


def _pixel_m(tags: dict[int, object]) -> tuple[float, float]:
    """Size of a pixel to the south and to the east.

    Raises:
        ValueError: the tags don't say it in metres, or the picture is turned.
    """
    scale, keys = tags.get(PIXEL_SCALE), tags.get(GEO_KEYS)
    if TRANSFORMATION in tags:
        raise ValueError("is turned or sheared: gdalwarp writes it with north at the top")
    if not isinstance(scale, tuple) or not isinstance(keys, tuple) or TIE_POINT not in tags:
        raise ValueError("has no geographic tags: it is a TIFF, but no GeoTIFF")
    values = {keys[i]: keys[i + 3] for i in range(4, len(keys) - 3, 4)}
    if values.get(MODEL_TYPE_KEY) != PROJECTED:
        raise ValueError("counts in degrees, and metres are needed: gdalwarp projects it, with -t_srs and -tr 1 1")
    if values.get(LINEAR_UNIT_KEY, METRE) not in (METRE, 32767):
        raise ValueError("does not count in metres: gdalwarp projects it, with -t_srs and -tr 1 1")
    east_m, south_m = float(scale[0]), float(scale[1])
    if not (0.0 < east_m < 1e4 and 0.0 < south_m < 1e4):
        raise ValueError(f"has pixels of {east_m:g} x {south_m:g} m")
    return south_m, east_m


def _bilinear(heights_m: Field, row: Field, column: Field) -> Field:
    i = np.clip(row.astype(int), 0, heights_m.shape[0] - 2)
    j = np.clip(column.astype(int), 0, heights_m.shape[1] - 2)
    a, b = (row - i)[:, None], (column - j)[None, :]
    h = heights_m
    above = (1.0 - b) * h[np.ix_(i, j)] + b * h[np.ix_(i, j + 1)]
    below = (1.0 - b) * h[np.ix_(i + 1, j)] + b * h[np.ix_(i + 1, j + 1)]
    result: Field = (1.0 - a) * above + a * below
    return result
