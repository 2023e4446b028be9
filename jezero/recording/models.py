"""What vehicle and rover look like in a 3D view: boxes, cylinders and lines in their own frames."""

from typing import TypedDict

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import AirframeConfig, PlatformConfig
from jezero.recording.foxglove import (
    LINE_LIST,
    ArrowPrimitive,
    Color,
    CubePrimitive,
    CylinderPrimitive,
    LinePrimitive,
    Pose,
    TextPrimitive,
    Vector3,
)


class Shapes(TypedDict, total=False):
    """Primitives of a `SceneEntity`, by the names of its fields."""

    arrows: tuple[ArrowPrimitive, ...]
    cubes: tuple[CubePrimitive, ...]
    cylinders: tuple[CylinderPrimitive, ...]
    lines: tuple[LinePrimitive, ...]
    texts: tuple[TextPrimitive, ...]


PLATFORM_THICKNESS_M = 0.04
TAG_THICKNESS_M = 0.004


def vehicle_shapes(airframe: AirframeConfig, color: Color) -> Shapes:
    """The vehicle in its frame `frd`: body, rotors, feet, and an arrow that points ahead."""
    rotors_m = [(forward_m, right_m, -0.04) for forward_m, right_m in airframe.pos_rotors_frd_m]
    diameter_m = 2.0 * airframe.radius_rotor_m
    forward_m, right_m = airframe.feet_frd_m
    legs_m: list[Vec3] = []
    for ahead in (1.0, -1.0):
        for side in (1.0, -1.0):
            legs_m.append((0.4 * ahead * forward_m, 0.4 * side * right_m, 0.0))
            legs_m.append((ahead * forward_m, side * right_m, airframe.height_stand_m))
    arms_m = [point_m for rotor_m in rotors_m for point_m in ((0.0, 0.0, -0.02), rotor_m)]
    return {
        "cubes": (_box((0.0, 0.0, 0.0), (0.24, 0.12, 0.08), color),),
        "cylinders": tuple(
            CylinderPrimitive(Pose(Vector3(*rotor_m)), Vector3(diameter_m, diameter_m, 0.01), color)
            for rotor_m in rotors_m
        ),
        "lines": (LinePrimitive(LINE_LIST, tuple(Vector3(*point_m) for point_m in (*arms_m, *legs_m)), color, 2.0),),
        "arrows": (_arrow_ahead((0.12, 0.0, 0.0), color),),
    }


def rover_shapes(platform: PlatformConfig, color: Color, color_tag: Color) -> Shapes:
    """The rover in its frame `rover_body`: platform with its biggest tag, body, and an arrow that points ahead."""
    side_m, height_m = platform.side_m, platform.height_m
    body_m = (0.8 * side_m, 0.6 * side_m, 0.7 * height_m)
    tag = max(platform.board, key=lambda tag: tag.side_m)
    return {
        "cubes": (
            _box((0.0, 0.0, 0.5 * PLATFORM_THICKNESS_M), (side_m, side_m, PLATFORM_THICKNESS_M), color),
            _box((0.0, 0.0, 0.5 * body_m[2] + PLATFORM_THICKNESS_M), body_m, color),
            _box(tag.pos_rover_body_m, (tag.side_m, tag.side_m, TAG_THICKNESS_M), color_tag),
        ),
        "arrows": (_arrow_ahead((0.5 * side_m, 0.0, 0.5 * PLATFORM_THICKNESS_M), color),),
    }


def _box(center_m: Vec3, size_m: Vec3, color: Color) -> CubePrimitive:
    return CubePrimitive(Pose(Vector3(*center_m)), Vector3(*size_m), color)


def _arrow_ahead(tail_m: Vec3, color: Color) -> ArrowPrimitive:
    return ArrowPrimitive(Pose(Vector3(*tail_m)), 0.1, 0.03, 0.08, 0.08, color)
