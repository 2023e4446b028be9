"""A folder of images that other programs can read as it is. Needs Pillow: `pip install 'jezero[cli]'`.

- `images/0000.jpg` …, or PNG, with date, time of exposure, focal length and GPS position in their EXIF.
- `images/images.json`: every image with the camera's pose and intrinsics, the vehicle's state and its sensors
  (`schemas/images.py` gives units and frames).
- `geo.txt`: OpenDroneMap's image geolocation file: name, longitude, latitude, altitude, `nan` for each of three angles,
  and the position's standard deviations, horizontal and vertical.

So the folder is a project of OpenDroneMap, which reads images from `images/` and `geo.txt` beside it. `images.json`
must not be beside `geo.txt`, because OpenDroneMap keeps its own list there.
"""

import itertools
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from math import degrees
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self

import msgspec

from jezero.base.extras import require
from jezero.base.files import naming, write_whole
from jezero.client.images import Picture
from jezero.schemas.images import LISTING, Image

if TYPE_CHECKING:
    from PIL.Image import Exif
    from PIL.TiffImagePlugin import IFDRational

Kind = Literal["jpg", "png"]
SUFFIXES = (".jpg", ".png")
JPEG_QUALITY = 95
SENSOR_WIDTH_MM = 6.4
"""EXIF needs a sensor size, which the simulated camera does not have; this one gives pixels of 10 um at 640 pixels."""
MAKE, MODEL = "jezero", "ventral"
EXIF_IFD, GPS_IFD = 0x8769, 0x8825
CENTIMETRE = 3


class _Listing(msgspec.Struct):
    images: list[dict[str, Any]]
    t0_utc: datetime | None = None
    planned: int | None = None
    track_ned_m: list[Any] = []
    earlier_tracks_ned_m: list[Any] = []


class Dataset:
    """Writer of a dataset: each image at once, with the lists, which are complete when the process is killed too.

    A `with` block writes the lists at its begin and its end.

    Args:
        folder: folder of the dataset; created if missing.
        kind: format of the images; JPEG is lossy, PNG is not.
        extra: further fields of `images.json`, e.g. the goal.

    Attributes:
        folder: folder of the dataset.
        planned: number of images that there will be, from an existing dataset; None if it is not known.

    Raises:
        FileExistsError: the folder has images of another dataset.
    """

    def __init__(self, folder: Path | str, kind: Kind = "jpg", **extra: Any) -> None:
        self._initialize(folder, kind, extra)
        if old := next((path for path in self._listing.parent.glob("*") if path.suffix in SUFFIXES), None):
            raise FileExistsError(f"{self.folder} has pictures already, e.g. {old.name}: choose another folder")

    def _initialize(self, folder: Path | str, kind: Kind, extra: dict[str, Any]) -> None:
        require("a dataset of images", "PIL")
        self.folder = Path(folder)
        self._kind = kind
        self._extra = extra
        self._images: dict[int, Image] = {}
        self._listing = self.folder / LISTING
        self._t0_utc: datetime | None = None
        self._newest_before_ns = -1
        self.planned: int | None = None

    @classmethod
    def reopen(cls, folder: Path | str, kind: Kind = "jpg", **extra: Any) -> Self:
        """Open an existing dataset to add images; the track of its flight becomes that of an earlier one.

        Args:
            folder: folder of the dataset.
            kind: format of the images, if there is none yet.
            extra: further fields of `images.json`.

        Raises:
            FileNotFoundError: the folder has no dataset.
            msgspec.DecodeError: its `images.json` is invalid.
        """
        listed = msgspec.json.decode((Path(folder) / LISTING).read_bytes(), type=_Listing)
        if listed.images:
            kind = "png" if str(listed.images[0].get("file", "")).endswith(".png") else "jpg"
        dataset = cls.__new__(cls)
        earlier = [track for track in (*listed.earlier_tracks_ned_m, listed.track_ned_m) if track]
        dataset._initialize(folder, kind, {"earlier_tracks_ned_m": earlier, **extra})
        for fields in listed.images:
            fields.pop("file", None)
            image = msgspec.convert(fields, Image)
            dataset._images[image.index] = image
        dataset._t0_utc = listed.t0_utc
        dataset.planned = listed.planned
        dataset._newest_before_ns = max((image.t_ns for image in dataset._images.values()), default=-1)
        return dataset

    def __enter__(self) -> Self:
        self._write_lists()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @property
    def count(self) -> int:
        """Number of images so far."""
        return len(self._images)

    @property
    def first_missing(self) -> int:
        """Lowest index without an image."""
        return next(index for index in itertools.count() if index not in self._images)

    def has(self, image: Image) -> bool:
        """Whether this image was added."""
        return image.index in self._images

    def note(self, **extra: Any) -> None:
        """Add fields to `images.json`."""
        self._extra.update(extra)

    def name_of(self, image: Image) -> str:
        """File name of an image."""
        return f"{image.index:04d}.{self._kind}"

    def add(self, picture: Picture) -> Path:
        """Write one image and the lists; returns its file.

        Raises:
            OSError: the file can't be written.
        """
        from PIL import Image as Pillow

        image = picture.image
        path = self._listing.with_name(self.name_of(image))
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = Pillow.frombytes("RGB", (image.width_px, image.height_px), picture.pixels)
        with naming(path):
            pixels.save(path, quality=JPEG_QUALITY, subsampling=0, exif=exif_of(image, self._taken_utc(image)))
        self._images[image.index] = image
        self._write_lists()
        return path

    def _taken_utc(self, image: Image) -> datetime:
        """UTC time of an image: the wall clock's for the first one, then by vehicle time, which has no date.

        A reopened dataset continues so, unless vehicle time has restarted in between.
        """
        since_t0 = timedelta(microseconds=image.t_ns // 1_000)
        if self._t0_utc is None or image.t_ns <= self._newest_before_ns:
            self._t0_utc, self._newest_before_ns = datetime.now(UTC) - since_t0, -1
        return self._t0_utc + since_t0

    def update(self, images: Iterable[Image]) -> None:
        """Replace the metadata of added images by that of the goal's result, whose positions may be corrected."""
        for image in images:
            if image.index in self._images:
                self._images[image.index] = image

    def close(self) -> None:
        """Write `images.json` and `geo.txt`, also without any image."""
        self._write_lists()

    def _write_lists(self) -> None:
        images = [self._images[index] for index in sorted(self._images)]
        listed = [{"file": self.name_of(image), **msgspec.to_builtins(image)} for image in images]
        content = msgspec.json.encode({**msgspec.to_builtins(self._extra), "t0_utc": self._t0_utc, "images": listed})
        self._listing.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self._listing, msgspec.json.format(content, indent=1) + b"\n")
        lines = [geo_line(self.name_of(image), image) for image in images if image.position_camera_deg is not None]
        write_whole(self.folder / "geo.txt", ("\n".join(["EPSG:4326", *lines]) + "\n").encode())


def geo_line(name: str, image: Image) -> str:
    """One line of `geo.txt`, with the standard deviations of the nearest GNSS fix if there is one."""
    assert image.position_camera_deg is not None
    latitude, longitude, altitude = image.position_camera_deg
    gnss = image.gnss
    accuracy = "" if gnss is None else f" {gnss.std_horizontal_m:.3f} {gnss.std_vertical_m:.3f}"
    return f"{name} {longitude:.9f} {latitude:.9f} {altitude:.3f} nan nan nan{accuracy}"


def exif_of(image: Image, taken_utc: datetime) -> "Exif":
    """EXIF of an image for viewers and photogrammetry.

    It has no focal length in 35 mm terms: that is in whole millimetres, and readers would prefer it to the exact one.
    """
    from PIL.Image import Exif
    from PIL.TiffImagePlugin import IFDRational

    exif = Exif()
    exif[0x010F], exif[0x0110] = MAKE, MODEL
    px_per_cm = _rational(10.0 * image.width_px / SENSOR_WIDTH_MM, 1_000)
    exif.get_ifd(EXIF_IFD).update(
        {
            0x829A: _rational(image.exposure_s, 1_000_000),
            0x9003: f"{taken_utc:%Y:%m:%d %H:%M:%S}",
            0x9011: "+00:00",
            # One digit, because some readers drop leading zeros.
            0x9290: str(taken_utc.microsecond // 100_000),
            0x9291: f"{taken_utc.microsecond // 1_000:03d}",
            0x920A: _rational(image.focal_px * SENSOR_WIDTH_MM / image.width_px, 1_000_000),
            0xA20E: px_per_cm,
            0xA20F: px_per_cm,
            0xA210: CENTIMETRE,
        }
    )
    if image.position_camera_deg is not None:
        latitude, longitude, altitude = image.position_camera_deg
        heading_cdeg = round(100.0 * degrees(image.yaw_rad)) % 36_000
        exif.get_ifd(GPS_IFD).update(
            {
                0: b"\2\3\0\0",
                1: "S" if latitude < 0.0 else "N",
                2: _sexagesimal(latitude),
                3: "W" if longitude < 0.0 else "E",
                4: _sexagesimal(longitude),
                5: b"\1" if altitude < 0.0 else b"\0",
                6: _rational(abs(altitude), 1_000),
                16: "T",
                17: IFDRational(heading_cdeg, 100),
            }
        )
    return exif


def _rational(value: float, denominator: int) -> "IFDRational":
    """Number as EXIF's rational; a float would make Pillow write a type that the tag does not allow."""
    from PIL.TiffImagePlugin import IFDRational

    return IFDRational(round(value * denominator), denominator)


def _sexagesimal(angle_deg: float) -> "tuple[IFDRational, IFDRational, IFDRational]":
    """Angle as whole degrees, whole minutes, and seconds with decimals; rounded first, so that no part becomes 60."""
    from PIL.TiffImagePlugin import IFDRational

    minutes, microseconds = divmod(round(abs(angle_deg) * 3600.0 * 1_000_000), 60 * 1_000_000)
    whole, minutes = divmod(minutes, 60)
    return (IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(microseconds, 1_000_000))
