"""PNG files with the standard library only."""

import struct
import zlib
from pathlib import Path


def png_file(file: Path | str) -> Path:
    """The path of a file that is to be written as a PNG.

    Raises:
        ValueError: its name doesn't end with .png.
    """
    path = Path(file)
    if path.suffix.lower() != ".png":
        raise ValueError(f"{file} is no name of a PNG file: end it with .png")
    return path


def png_of(width_px: int, height_px: int, pixels: bytes) -> bytes:
    """Encode pixels, rows from the top, three bytes red, green, blue each, as a PNG. Source: W3C PNG specification."""
    row = 3 * width_px
    lines = b"".join(b"\0" + pixels[i * row : (i + 1) * row] for i in range(height_px))
    header = struct.pack(">IIBBBBB", width_px, height_px, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(lines, 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
