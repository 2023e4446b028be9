"""Intrinsics of a camera: read from files of ROS and Kalibr, written as ROS' and as lines of `vehicle.toml`."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
import yaml
from msgspec import Meta

from jezero.base.files import NOT_UTF8
from jezero.base.mistakes import mistake
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.schemas.sensors import COEFFICIENTS, Distortion, DistortionModel

Matrix3 = Annotated[list[float], Meta(min_length=9, max_length=9)]
Four = Annotated[list[float], Meta(min_length=4, max_length=4)]
FILE_MAX_BYTES = 1_000_000


class IntrinsicsError(ValueError):
    """A file has no intrinsics that jezero can use; the message says why."""


@dataclass(frozen=True)
class CameraIntrinsics:
    """A calibration.

    Attributes:
        size_px: width and height of the pictures.
        focal_px: fx and fy.
        center_px: cx and cy; (0, 0) is the centre of the first pixel.
        model: of the lens.
        distortion: its coefficients.
    """

    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    model: DistortionModel
    distortion: Distortion


class _RosMatrix(msgspec.Struct, frozen=True):
    data: list[float]


class _RosFile(msgspec.Struct, frozen=True):
    """ROS' camera_info file, of the package camera_calibration_parsers."""

    image_width: int
    image_height: int
    camera_matrix: _RosMatrix
    distortion_coefficients: _RosMatrix
    distortion_model: str = "plumb_bob"


class _KalibrCamera(msgspec.Struct, frozen=True):
    """One camera of Kalibr's camchain file."""

    camera_model: str
    intrinsics: Four
    distortion_model: str
    distortion_coeffs: list[float]
    resolution: Annotated[list[int], Meta(min_length=2, max_length=2)]


ROS_MODELS: dict[str, DistortionModel] = {
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}


def read_intrinsics(path: Path, camera: str = "cam0") -> CameraIntrinsics:
    """Read a file of ROS (camera_info) or of Kalibr (camchain).

    Args:
        camera: name of the camera in a file of Kalibr.

    Raises:
        IntrinsicsError: it can't be read, or is neither, or its model is unknown.
    """
    try:
        if path.stat().st_size > FILE_MAX_BYTES:
            raise IntrinsicsError(f"{path} has more than {FILE_MAX_BYTES} bytes: it is no calibration")
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise IntrinsicsError(f"{path} can't be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise IntrinsicsError(f"{path} {NOT_UTF8}") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise IntrinsicsError(f"{path} is not YAML: {error}") from None
    if not isinstance(document, dict):
        raise IntrinsicsError(f"{path} is neither a camera_info file of ROS nor a camchain of Kalibr")
    try:
        if "camera_matrix" in document:
            return _checked(path, _of_ros(path, msgspec.convert(document, _RosFile)))
        cameras = [name for name in document if re.fullmatch(r"cam\d+", str(name))]
        if not cameras:
            raise IntrinsicsError(f"{path} is neither a camera_info file of ROS nor a camchain of Kalibr")
        if camera not in cameras:
            raise IntrinsicsError(f"{path} has no camera {camera}; there are {', '.join(cameras)}")
        return _checked(path, _of_kalibr(path, msgspec.convert(document[camera], _KalibrCamera)))
    except msgspec.ValidationError as error:
        kind = _RosFile if "camera_matrix" in document else _KalibrCamera
        raise IntrinsicsError(f"{path}: {mistake(error, kind, 'field')}") from None


def _of_ros(path: Path, file: _RosFile) -> CameraIntrinsics:
    model = ROS_MODELS.get(file.distortion_model)
    if model is None:
        raise IntrinsicsError(
            f"{path}: the distortion model {file.distortion_model!r} is none of {', '.join(ROS_MODELS)}"
        )
    if len(file.camera_matrix.data) != 9:
        raise IntrinsicsError(f"{path}: camera_matrix has {len(file.camera_matrix.data)} numbers, expected 9")
    fx, _, cx, _, fy, cy, *_ = file.camera_matrix.data
    coefficients = file.distortion_coefficients.data
    if model == "plumb_bob" and len(coefficients) == 4:
        coefficients = [*coefficients, 0.0]
    return CameraIntrinsics((file.image_width, file.image_height), (fx, fy), (cx, cy), model, tuple(coefficients))


def _of_kalibr(path: Path, camera: _KalibrCamera) -> CameraIntrinsics:
    if camera.camera_model != "pinhole":
        raise IntrinsicsError(
            f"{path}: Kalibr's camera model {camera.camera_model!r} is not known here: calibrate as pinhole"
        )
    fx, fy, cx, cy = camera.intrinsics
    model: DistortionModel
    coefficients = camera.distortion_coeffs
    if camera.distortion_model == "equidistant":
        model = "equidistant"
    elif camera.distortion_model in ("radtan", "none"):
        model, coefficients = "plumb_bob", [*(coefficients or [0.0] * 4), 0.0]  # it has no k3
    else:
        raise IntrinsicsError(
            f"{path}: Kalibr's distortion model {camera.distortion_model!r} is none of radtan, equidistant"
        )
    width_px, height_px = camera.resolution
    return CameraIntrinsics((width_px, height_px), (fx, fy), (cx, cy), model, tuple(coefficients))


def _checked(path: Path, found: CameraIntrinsics) -> CameraIntrinsics:
    """The intrinsics, if `vehicle.toml` may have them.

    Raises:
        IntrinsicsError: it may not.
    """
    count = COEFFICIENTS[found.model]
    if len(found.distortion) != count:
        raise IntrinsicsError(f"{path}: {found.model} has {count} coefficients, not {len(found.distortion)}")
    try:
        msgspec.convert({"camera": _fields(found)}, VehicleConfig)
    except msgspec.ValidationError as error:
        raise IntrinsicsError(f"{path}: {mistake(error, VehicleConfig, 'setting')}") from None
    return found


def _fields(found: CameraIntrinsics) -> dict[str, Any]:
    """The fields of `vehicle.toml`'s table `camera`."""
    (width_px, height_px), (fx, fy), (cx, cy) = found.size_px, found.focal_px, found.center_px
    return {
        "width_px": width_px,
        "height_px": height_px,
        "fx_px": round(float(fx), 4),
        "fy_px": round(float(fy), 4),
        "cx_px": round(float(cx), 4),
        "cy_px": round(float(cy), 4),
        "distortion_model": found.model,
        "distortion": [round(float(k), 8) for k in found.distortion],
    }


def toml_lines(found: CameraIntrinsics) -> list[str]:
    """The lines for the table `camera` of `vehicle.toml`."""
    return [
        f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value}"
        for name, value in _fields(found).items()
    ]


def with_intrinsics(text: str, found: CameraIntrinsics) -> str:
    """The text of a `vehicle.toml` with other intrinsics; all other lines stay.

    Raises:
        IntrinsicsError: the text is no `vehicle.toml`, before or after.
    """
    table = re.search(r"^\[camera\][^\n]*\n", text, re.MULTILINE)
    if table is None:
        text, begin = f"{text.rstrip()}\n\n[camera]\n", None
        table = cast(re.Match[str], re.search(r"^\[camera\][^\n]*\n", text, re.MULTILINE))
    begin = table.end()
    following = re.search(r"^\[", text[begin:], re.MULTILINE)
    end = len(text) if following is None else begin + following.start()
    inside = text[begin:end]
    for line in toml_lines(found):
        name = line.partition(" ")[0]
        live = re.compile(rf"^[ \t]*{name}[ \t]*=[ \t]*(\[[^\]]*\]|[^#\n]*?)([ \t]*#.*)?$", re.MULTILINE)
        commented = re.compile(rf"^#[ \t]*{name}[ \t]*=[^\n]*$", re.MULTILINE)
        if live.search(inside):
            inside = live.sub(lambda old, line=line: line + (old[2] or ""), inside, count=1)  # type: ignore[misc]
        elif commented.search(inside):
            inside = commented.sub(lambda old, line=line: line, inside, count=1)  # type: ignore[misc]
        else:
            inside = f"{line}\n{inside}"
    written = text[:begin] + inside + text[end:]
    try:
        made = msgspec.toml.decode(written, type=VehicleConfig).camera
    except msgspec.DecodeError as error:
        raise IntrinsicsError(f"the result would be no vehicle.toml: {error}") from None
    if msgspec.to_builtins(made) != msgspec.to_builtins(_mounted(made, found)):
        raise IntrinsicsError("the table [camera] could not be rewritten: put the lines in by hand")
    return written


def _mounted(camera: CameraMountConfig, found: CameraIntrinsics) -> CameraMountConfig:
    fields = _fields(found)
    return msgspec.structs.replace(camera, **{**fields, "distortion": tuple(fields["distortion"])})


def ros_yaml(found: CameraIntrinsics, name: str) -> str:
    """A camera_info file of ROS."""
    (fx, fy), (cx, cy) = found.focal_px, found.center_px

    def matrix(rows: int, columns: int, data: list[float]) -> dict[str, Any]:
        return {"rows": rows, "cols": columns, "data": [float(value) for value in data]}

    document = {
        "image_width": found.size_px[0],
        "image_height": found.size_px[1],
        "camera_name": name,
        "camera_matrix": matrix(3, 3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        "distortion_model": found.model,
        "distortion_coefficients": matrix(1, len(found.distortion), list(found.distortion)),
        "rectification_matrix": matrix(3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": matrix(3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    }
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
