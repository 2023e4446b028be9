"""Foxglove's messages that jezero writes, with the names and fields of Foxglove's own schemas.

Source: https://docs.foxglove.dev/docs/sdk/schemas. Foxglove knows a message by the name of its schema. All fields are
written, also those with a default, because those schemas require them.
"""

from typing import Annotated, Any

import msgspec
from msgspec import Meta

from jezero.schemas.units import NS_PER_S

Base64 = Annotated[str, Meta(extra_json_schema={"contentEncoding": "base64"})]
"""Bytes, which viewers decode."""


class Time(msgspec.Struct, frozen=True):
    """A time of the recording: whole seconds and the rest in ns."""

    sec: int
    nsec: int


class Duration(msgspec.Struct, frozen=True):
    """A duration: whole seconds and the rest in ns."""

    sec: int
    nsec: int = 0


def time_of(t_ns: int) -> Time:
    """The message's form of a time in ns."""
    return Time(t_ns // NS_PER_S, t_ns % NS_PER_S)


class Vector3(msgspec.Struct, frozen=True):
    """A vector, or a point (`foxglove.Point3` has the same fields), in m."""

    x: float
    y: float
    z: float


class Quaternion(msgspec.Struct, frozen=True):
    """A rotation; jezero's quaternions begin with w."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(msgspec.Struct, frozen=True):
    """A position and an orientation in the frame of the entity."""

    position: Vector3
    orientation: Quaternion = Quaternion()


class Color(msgspec.Struct, frozen=True):
    """Red, green, blue and opacity, each from 0 to 1."""

    r: float
    g: float
    b: float
    a: float = 1.0


class FrameTransform(msgspec.Struct, frozen=True):
    """Pose of a frame in its parent: p_parent = translation + rotation * p_child."""

    timestamp: Time
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class FrameTransforms(msgspec.Struct, frozen=True):
    """Poses of several frames."""

    transforms: tuple[FrameTransform, ...]


class CubePrimitive(msgspec.Struct, frozen=True):
    """A box around its pose."""

    pose: Pose
    size: Vector3
    color: Color


class SpherePrimitive(msgspec.Struct, frozen=True):
    """An ellipsoid around its pose; the size has its diameters."""

    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(msgspec.Struct, frozen=True):
    """A cylinder along z around its pose; the size has its diameters and its height."""

    pose: Pose
    size: Vector3
    color: Color
    bottom_scale: float = 1.0
    top_scale: float = 1.0


class ArrowPrimitive(msgspec.Struct, frozen=True):
    """An arrow along x from its pose."""

    pose: Pose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: Color


LINE_STRIP, LINE_LIST = 0, 2


class LinePrimitive(msgspec.Struct, frozen=True):
    """Lines through points: a connected one (`LINE_STRIP`), or one for each two points (`LINE_LIST`)."""

    type: int
    points: tuple[Vector3, ...]
    color: Color
    thickness: float
    scale_invariant: bool = True
    pose: Pose = Pose(Vector3(0.0, 0.0, 0.0))
    colors: tuple[Color, ...] = ()
    indices: tuple[int, ...] = ()


class TextPrimitive(msgspec.Struct, frozen=True):
    """A text that faces the viewer."""

    pose: Pose
    text: str
    color: Color
    font_size: float
    billboard: bool = True
    scale_invariant: bool = True


class TriangleListPrimitive(msgspec.Struct, frozen=True):
    """Triangles, one for each three points."""

    points: tuple[Vector3, ...]
    color: Color
    pose: Pose = Pose(Vector3(0.0, 0.0, 0.0))
    colors: tuple[Color, ...] = ()
    indices: tuple[int, ...] = ()


class ModelPrimitive(msgspec.Struct, frozen=True):
    """A 3D model from a file at an address, or with its bytes in base64."""

    pose: Pose
    scale: Vector3
    color: Color
    override_color: bool
    url: str
    media_type: str
    data: Base64


class KeyValuePair(msgspec.Struct, frozen=True):
    """A key and its value."""

    key: str
    value: str


class SceneEntity(msgspec.Struct, frozen=True, kw_only=True):
    """A thing in the scene; it replaces the former one with its id."""

    timestamp: Time
    frame_id: str
    id: str
    lifetime: Duration
    frame_locked: bool = True
    metadata: tuple[KeyValuePair, ...] = ()
    arrows: tuple[ArrowPrimitive, ...] = ()
    cubes: tuple[CubePrimitive, ...] = ()
    spheres: tuple[SpherePrimitive, ...] = ()
    cylinders: tuple[CylinderPrimitive, ...] = ()
    lines: tuple[LinePrimitive, ...] = ()
    triangles: tuple[TriangleListPrimitive, ...] = ()
    texts: tuple[TextPrimitive, ...] = ()
    models: tuple[ModelPrimitive, ...] = ()


class SceneEntityDeletion(msgspec.Struct, frozen=True):
    """Removal of an entity."""

    timestamp: Time
    type: int
    id: str


class SceneUpdate(msgspec.Struct, frozen=True):
    """Entities that are added or replaced."""

    entities: tuple[SceneEntity, ...]
    deletions: tuple[SceneEntityDeletion, ...] = ()


COVARIANCE_UNKNOWN, COVARIANCE_APPROXIMATED = 0, 1


class LocationFix(msgspec.Struct, frozen=True, kw_only=True):
    """A position on the earth: degrees, and metres up; the covariance is that of east, north and up in m^2."""

    timestamp: Time
    frame_id: str
    latitude: float
    longitude: float
    altitude: float
    position_covariance: tuple[float, ...]
    position_covariance_type: int


class CameraCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """Intrinsics of a camera: size in pixels, distortion `D`, camera matrix `K`, and `R` and `P` of stereo cameras."""

    timestamp: Time
    frame_id: str
    width: int
    height: int
    distortion_model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    R: tuple[float, ...]
    P: tuple[float, ...]


class CompressedImage(msgspec.Struct, frozen=True, kw_only=True):
    """An image of a camera: the bytes of a JPEG."""

    timestamp: Time
    frame_id: str
    data: Base64
    format: str


_TITLES = {"Time": "time", "Duration": "duration"}


def schema_name(message: type[msgspec.Struct]) -> str:
    """Name by which Foxglove knows a message or a part of one."""
    return _TITLES.get(message.__name__, f"foxglove.{message.__name__}")


def json_schema(message: type[msgspec.Struct]) -> dict[str, Any]:
    """JSON Schema of a message, with Foxglove's names as titles, and references."""
    _, definitions = msgspec.json.schema_components([message], ref_template="#/$defs/{name}")
    for name, definition in definitions.items():
        definition["title"] = _TITLES.get(name, f"foxglove.{name}")
    return {**definitions[message.__name__], "$defs": definitions}
