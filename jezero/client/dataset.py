"""A folder of pictures that other programs take as it is. Needs Pillow: `pip install 'jezero[cli]'`.

- `0000.jpg` …, or PNG, with time of exposure, focal length and GPS position in their EXIF.
- `images.json`: every picture with the camera's pose and intrinsics, the vehicle's state and its sensors
  (`schemas/images.py` tells units and frames).
- `geo.txt`: OpenDroneMap's image geolocation file: name, longitude, latitude, altitude, and the camera's attitude as
  omega, phi, kappa in degrees. Source: OpenDroneMap, `opendm/geo.py` and `opendm/photo.py`.
"""

from collections.abc import Iterable
from math import asin, atan2, degrees
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self

import msgspec

from jezero.client.images import Picture
from jezero.schemas.images import Image, QuatNedFromCamera

if TYPE_CHECKING:
    from PIL.Image import Exif

Kind = Literal["jpg", "png"]
LISTING = "images.json"
JPEG_QUALITY = 95
SENSOR_WIDTH_MM = 6.4
"""The simulated camera has pixels, but no millimetres: EXIF needs both, so one is chosen (10 um at 640 pixels)."""
MAKE, MODEL = "jezero", "ventral"
EXIF_IFD, GPS_IFD = 0x8769, 0x8825


class _Listing(msgspec.Struct):
    images: list[dict[str, Any]]


class Dataset:
    """Writes pictures into a folder as they come; the lists of them at the end, or at the end of a `with` block.

    Args:
        folder: made when it isn't there.
        kind: of the pictures' files; JPEG loses a little, PNG nothing.
        extra: told in `images.json` too, e.g. the goal.
    """

    def __init__(self, folder: Path | str, kind: Kind = "jpg", **extra: Any) -> None:
        self.folder = Path(folder)
        self._kind = kind
        self._extra = extra
        self._images: dict[int, Image] = {}
        self.folder.mkdir(parents=True, exist_ok=True)

    @classmethod
    def reopen(cls, folder: Path | str, **extra: Any) -> Self:
        """A dataset that was written before, to add more pictures to.

        Raises:
            FileNotFoundError: there is none in this folder.
            msgspec.DecodeError: its `images.json` is broken.
        """
        told = msgspec.json.decode((Path(folder) / LISTING).read_bytes(), type=_Listing)
        png = bool(told.images) and str(told.images[0].get("file", "")).endswith(".png")
        dataset = cls(folder, "png" if png else "jpg", **extra)
        for fields in told.images:
            fields.pop("file", None)
            image = msgspec.convert(fields, Image)
            dataset._images[image.index] = image
        return dataset

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @property
    def count(self) -> int:
        """Pictures so far."""
        return len(self._images)

    def has(self, image: Image) -> bool:
        """Whether this picture was added."""
        return image.index in self._images

    def note(self, **extra: Any) -> None:
        """Something more to be told in `images.json`."""
        self._extra.update(extra)

    def name_of(self, image: Image) -> str:
        """Its file's name."""
        return f"{image.index:04d}.{self._kind}"

    def add(self, picture: Picture) -> Path:
        """Write one picture; returns its file.

        Raises:
            OSError: it can't be written.
        """
        from PIL import Image as Pillow

        image = picture.image
        path = self.folder / self.name_of(image)
        pixels = Pillow.frombytes("RGB", (image.width_px, image.height_px), picture.pixels)
        pixels.save(path, quality=JPEG_QUALITY, subsampling=0, exif=exif_of(image))
        self._images[image.index] = image
        return path

    def update(self, images: Iterable[Image]) -> None:
        """What is known of pictures that were added, now that the goal is over: positions may have been corrected."""
        for image in images:
            if image.index in self._images:
                self._images[image.index] = image

    def close(self) -> None:
        """Write `images.json` and `geo.txt`, also when there is no picture."""
        images = [self._images[index] for index in sorted(self._images)]
        told = [{"file": self.name_of(image), **msgspec.to_builtins(image)} for image in images]
        content = msgspec.json.encode({**msgspec.to_builtins(self._extra), "images": told})
        (self.folder / LISTING).write_bytes(msgspec.json.format(content, indent=1) + b"\n")
        lines = [geo_line(self.name_of(image), image) for image in images if image.position_camera_deg is not None]
        (self.folder / "geo.txt").write_text("\n".join(["EPSG:4326", *lines]) + "\n")


def geo_line(name: str, image: Image) -> str:
    """One line of `geo.txt`."""
    assert image.position_camera_deg is not None
    latitude, longitude, altitude = image.position_camera_deg
    angles = " ".join(f"{degrees(angle):.4f}" for angle in omega_phi_kappa(image.q_ned_from_camera))
    return f"{name} {longitude:.9f} {latitude:.9f} {altitude:.3f} {angles}"


def omega_phi_kappa(q_ned_from_camera: QuatNedFromCamera) -> tuple[float, float, float]:
    """Photogrammetric angles in radians: R_enu_from_image = Rx(omega) Ry(phi) Rz(kappa).

    The image's axes are right, up, and backwards against the view; looking straight down with north at the top of the
    picture, all angles are zero.
    """
    right, down, forward = (_turned(q_ned_from_camera, axis) for axis in range(3))
    # Rows are east, north and up of the image's right, up and backward axes.
    r00, r01, r02 = right[1], -down[1], -forward[1]
    r12 = -forward[0]
    r22 = forward[2]
    return atan2(-r12, r22), asin(max(-1.0, min(1.0, r02))), atan2(-r01, r00)


def _turned(q: QuatNedFromCamera, axis: int) -> tuple[float, float, float]:
    """North, east and down of one of the camera's axes: a column of the rotation's matrix."""
    w, x, y, z = q
    columns = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return columns[axis]


def exif_of(image: Image) -> "Exif":
    """What viewers and photogrammetry read from the file itself.

    Times of the picture are vehicle time, which starts at 0: as a date it has none.
    """
    from PIL.Image import Exif

    exif = Exif()
    exif[0x010F], exif[0x0110] = MAKE, MODEL
    focal_mm = image.focal_px * SENSOR_WIDTH_MM / image.width_px
    focal_35mm = round(focal_mm * 36.0 / SENSOR_WIDTH_MM)
    exif.get_ifd(EXIF_IFD).update({0x829A: image.exposure_s, 0x920A: focal_mm, 0xA405: focal_35mm})
    if image.position_camera_deg is not None:
        latitude, longitude, altitude = image.position_camera_deg
        heading_deg = degrees(image.yaw_rad) % 360.0
        exif.get_ifd(GPS_IFD).update(
            {
                0: b"\2\3\0\0",
                1: "S" if latitude < 0.0 else "N",
                2: _sexagesimal(latitude),
                3: "W" if longitude < 0.0 else "E",
                4: _sexagesimal(longitude),
                5: b"\1" if altitude < 0.0 else b"\0",
                6: abs(altitude),
                16: "T",
                17: heading_deg,
            }
        )
    return exif


def _sexagesimal(angle_deg: float) -> tuple[float, float, float]:
    """Degrees, minutes and seconds, which alone has decimals."""
    minutes, seconds = divmod(abs(angle_deg) * 3600.0, 60.0)
    whole, minutes = divmod(minutes, 60.0)
    return (whole, minutes, round(seconds, 6))
