"""The images of a dataset and their poses, as arrays."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from jezero.base.arrays import Array
from jezero.base.frames import Vec3, add, ned_from_geodetic, origin_from, quat_rotate, subtract
from jezero.base.lens import undistorted_picture
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.images import LISTING, Image
from jezero.schemas.sensors import Distortion

Pixels = NDArray[np.uint8]
NORM_ERROR_MAX = 0.01
"""Of quaternions, which other programs may have rounded."""


class SurveyError(ValueError):
    """The folder can't be mapped; the message gives the reason and the remedy."""


class _Entry(msgspec.Struct):
    file: str


class _Listing(msgspec.Struct):
    images: list[msgspec.Raw]


@dataclass(frozen=True)
class Survey:
    """n images of one camera.

    Attributes:
        files: files of the images.
        times_s: (n,) times of the exposures.
        pos_m: (n, 3) positions of the camera, NED.
        rotations: (n, 3, 3) rotations from the camera's axes right, down, forward to north, east, down.
        focal_px: focal length.
        center_px: (2,) principal point.
        distortion: coefficients of the lens' distortion, which `pixels` no longer have.
        aspect: focal length down the image by that across it, which are the same in `pixels`.
        size_px: width and height.
        spots_m: (m, 3) points at which the altimeter's beam met the ground, by the vehicle's own position, NED.
        origin_deg: latitude, longitude and altitude of the positions' origin. None when no image has a position in
            degrees.
    """

    files: tuple[Path, ...]
    times_s: Array
    pos_m: Array
    rotations: Array
    focal_px: float
    center_px: tuple[float, float]
    distortion: Distortion
    aspect: float
    size_px: tuple[int, int]
    spots_m: Array
    origin_deg: Vec3 | None

    def __len__(self) -> int:
        return len(self.files)

    def pixels(self, number: int) -> Pixels:
        """(height, width, 3) pixels of an image: red, green, blue.

        Raises:
            SurveyError: its file is missing or invalid.
        """
        picture = cv2.imread(str(self.files[number]), cv2.IMREAD_COLOR)
        if picture is None:
            raise SurveyError(f"{self.files[number]} can't be read")
        width_px, height_px = self.size_px
        if picture.shape[:2] != (height_px, width_px):
            raise SurveyError(f"{self.files[number]} is not {width_px} x {height_px} pixels as {LISTING} says")
        picture = undistorted_picture(
            np.asarray(picture, np.uint8), self.focal_px, self.center_px, self.distortion, self.aspect
        )
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)

    @cached_property
    def rays_of_corners(self) -> Array:
        """(4, 3) rays through the image's corners, in the camera's axes."""
        width_px, height_px = self.size_px
        corners_px = np.array([(0, 0), (width_px - 1, 0), (width_px - 1, height_px - 1), (0, height_px - 1)], float)
        return self.rays(corners_px)

    def rays(self, points_px: Array) -> Array:
        """(k, 3) rays through (k, 2) points of the image, in the camera's axes."""
        across = (points_px - np.array(self.center_px)) / self.focal_px
        return np.column_stack((across, np.ones(len(points_px))))

    def moved(self, pos_m: Array, rotations: Array) -> "Survey":
        """The same images with other poses."""
        return replace(self, pos_m=pos_m, rotations=rotations)


def read_survey(folder: Path, vehicle: VehicleConfig) -> Survey:
    """Read the dataset of a coverage.

    Args:
        vehicle: with which the images were taken.

    Raises:
        SurveyError: the folder has no dataset, or none of its images has an altimeter range.
    """
    listing = folder / LISTING
    try:
        entries = msgspec.json.decode(listing.read_bytes(), type=_Listing).images
        files = [msgspec.json.decode(entry, type=_Entry).file for entry in entries]
        images = [_image(entry) for entry in entries]
    except FileNotFoundError:
        raise SurveyError(f"{folder} has no {LISTING}: is it the folder of a gridsweep?") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise SurveyError(f"{listing} is not a dataset's list of images: {error}") from None
    if not images:
        raise SurveyError(f"{listing} lists no images")
    for file, image in zip(files, images, strict=True):
        for name in ("q_ned_from_camera", "q_ned_from_frd"):
            if abs(hypot(*getattr(image, name)) - 1.0) > NORM_ERROR_MAX:
                raise SurveyError(f"{listing}: {name} of {file} is no attitude, because its length is not 1")
    kinds = {
        (image.focal_px, image.aspect, image.center_px, image.distortion, image.width_px, image.height_px)
        for image in images
    }
    if len(kinds) > 1:
        raise SurveyError(f"{listing} has images of {len(kinds)} different cameras: map each camera alone")
    if images[0].focal_px <= 0.0:
        raise SurveyError(f"{listing} has images with a focal length of 0")
    images, origin_deg = _in_one_frame(images)
    spots_m = [_spot(image, vehicle) for image in images if image.range_m is not None]
    if not spots_m:
        reach_m = vehicle.altimeter.range_max_m
        raise SurveyError(f"no image in {folder} has an altimeter range: the laser reaches {reach_m:g} m, fly lower")
    first = images[0]
    return Survey(
        files=tuple(listing.parent / file for file in files),
        times_s=np.array([image.t_ns for image in images]) * 1e-9,
        pos_m=np.array([image.pos_camera_ned_m for image in images]),
        rotations=np.array([_matrix(image) for image in images]),
        focal_px=first.focal_px,
        center_px=first.center_px,
        distortion=first.distortion,
        aspect=first.aspect,
        size_px=(first.width_px, first.height_px),
        spots_m=np.array(spots_m),
        origin_deg=origin_deg,
    )


def _image(entry: msgspec.Raw) -> Image:
    fields = msgspec.json.decode(entry)
    fields.pop("file", None)
    return msgspec.convert(fields, Image)


def _in_one_frame(images: list[Image]) -> tuple[list[Image], Vec3 | None]:
    """The images with all positions in the frame of the first one that has degrees, and this frame's origin.

    Each start of the autopilot has an origin of its own, which differs between the flights of a coverage. Heights stay:
    each flight counts them from the ground on which it started.
    """
    origins_deg = [
        None if image.position_camera_deg is None else origin_from(image.pos_camera_ned_m, image.position_camera_deg)
        for image in images
    ]
    first_deg = next((origin for origin in origins_deg if origin is not None), None)
    if first_deg is None:
        return images, None
    shifted = []
    for image, origin in zip(images, origins_deg, strict=True):
        north_m, east_m, _ = (0.0, 0.0, 0.0) if origin is None else ned_from_geodetic(origin, first_deg)
        pos_m = add(image.pos_camera_ned_m, (north_m, east_m, 0.0))
        shifted.append(msgspec.structs.replace(image, pos_camera_ned_m=pos_m))
    return shifted, first_deg


def _matrix(image: Image) -> Array:
    axes = [quat_rotate(image.q_ned_from_camera, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    return np.array(axes).T


def _spot(image: Image, vehicle: VehicleConfig) -> Array:
    """Point at which the altimeter's beam met the ground."""
    laser_frd_m = subtract(vehicle.altimeter.pos_altimeter_frd_m, vehicle.camera.pos_camera_frd_m)
    beam_frd_m = add(laser_frd_m, (0.0, 0.0, image.range_m or 0.0))
    return np.add(image.pos_camera_ned_m, quat_rotate(image.q_ned_from_frd, beam_frd_m))
