"""What stands in the terrain, as `simulator.toml` lists it: boxes, poles, and models from files of one's own.

Physics, altimeter and both renderers of the camera get the same triangles.
"""

import struct
from math import cos, sin
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.base.config import ConfigError, settings_path
from jezero.base.files import describe_os_error
from jezero.base.frames import Vec3
from jezero.schemas.simulator import ObstaclePlace
from jezero.schemas.terrain import TRIANGLES_MAX, Obstacle
from jezero.services.simulator.config import BoxConfig, ModelConfig, PoleConfig, TerrainConfig
from jezero.services.simulator.shapes import Mesh, box, mesh_of, rod
from jezero.services.simulator.terrain import Terrain, make_terrain

SUNK_M = 0.5
"""What stands on the ground reaches this far into it, so that there is no gap below it on a slope."""
POLE_SIDES = 16
MODEL_TRIANGLES_MAX = 20_000
MODEL_SIZE_MIN_M, MODEL_SIZE_MAX_M = 0.01, 200.0

Y_UP: Array = np.array(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
"""Turns a point of a file whose y axis points up, and whose z axis points forward, into NED, for a heading of 0."""
Z_UP: Array = np.diag((1.0, -1.0, -1.0))
"""Turns a point of a file whose z axis points up, and whose x axis points forward, into NED, for a heading of 0."""
AXES = {".glb": Y_UP, ".gltf": Y_UP, ".obj": Y_UP, ".stl": Z_UP, ".ply": Z_UP}
"""Formats of models, and the directions of their axes. They are those of the standard for glTF 2.0, those that most
programs write for OBJ, and those of ROS (REP 103) for STL and PLY."""
BROKEN_FILE = (
    ValueError,
    LookupError,
    OSError,
    TypeError,
    AttributeError,
    ImportError,
    NotImplementedError,
    struct.error,
)
"""What trimesh raises for a file that it can't read."""


class StandingObstacle(NamedTuple):
    """One obstacle in the map.

    Attributes:
        name: name of the setting and its number, such as "box 2"; the file of a model is added.
        mesh: its triangles.
        sunk_m: how far it reaches into the ground.
    """

    name: str
    mesh: Mesh
    sunk_m: float = 0.0

    @property
    def corners_ned_m(self) -> Array:
        """(3 x triangles, 3) positions in the map."""
        corners_m: Array = self.mesh[:, :3].astype(np.float64)
        return corners_m

    @property
    def limits_ned_m(self) -> Array:
        """(2, 3) least and greatest position of the box around it."""
        limits_m: Array = np.stack((self.corners_ned_m.min(axis=0), self.corners_ned_m.max(axis=0)))
        return limits_m

    def holds(self, pos_ned_m: Vec3) -> bool:
        """Whether a position is inside the obstacle: the way out, straight up, crosses its surface an odd number of
        times."""
        start_m = np.array(pos_ned_m)
        crossed = _crossings(self.corners_ned_m.reshape(-1, 3, 3), start_m, start_m[None] - np.array((0.0, 0.0, 1e3)))
        return bool(crossed.sum() % 2)

    def is_near(self, pos_ned_m: Vec3, clearance_m: float) -> bool:
        """Whether a position is in the box around the obstacle, or less than `clearance_m` from it."""
        least_m, most_m = self.limits_ned_m
        return bool(np.all(np.array(pos_ned_m) > least_m - clearance_m) and np.all(pos_ned_m < most_m + clearance_m))


def make_obstacles(config: TerrainConfig, terrain: Terrain) -> tuple[StandingObstacle, ...]:
    """The obstacles of the settings on their ground.

    Raises:
        ConfigError: the file of a model can't be used.
    """
    return tuple(
        [
            StandingObstacle(f"box {i}", _box(each, terrain), 0.0 if each.height_m else SUNK_M)
            for i, each in enumerate(config.boxes, 1)
        ]
        + [StandingObstacle(f"pole {i}", _pole(each, terrain), SUNK_M) for i, each in enumerate(config.poles, 1)]
        + [
            StandingObstacle(f"model {i} ({Path(each.file).name})", _model(each, terrain))
            for i, each in enumerate(config.models, 1)
        ]
    )


def obstacle_triangles(config: TerrainConfig) -> Array:
    """(n, 3, 3) corners of all triangles of the obstacles, in the map.

    Raises:
        ConfigError: the file of a model can't be used.
    """
    if not (config.boxes or config.poles or config.models):
        return np.zeros((0, 3, 3))
    obstacles = make_obstacles(config, make_terrain(config))
    return np.concatenate([each.corners_ned_m for each in obstacles]).reshape(-1, 3, 3)


def _box(config: BoxConfig, terrain: Terrain) -> Mesh:
    length_m, width_m, tall_m = config.size_m
    sunk_m = 0.0 if config.height_m else SUNK_M
    half_m = (0.5 * length_m, 0.5 * width_m, 0.5 * (tall_m + sunk_m))
    mesh = box((0.0, 0.0, -0.5 * (tall_m - sunk_m)), half_m, config.colour)
    return _placed(mesh[:, :3].astype(np.float64).reshape(-1, 3, 3), mesh[:, 6:9].astype(np.float64), config, terrain)


def _pole(config: PoleConfig, terrain: Terrain) -> Mesh:
    foot_m = -terrain.height_m(config.north_m, config.east_m)
    place = config.north_m, config.east_m
    return rod(
        (*place, foot_m + SUNK_M), (*place, foot_m - config.length_m), config.radius_m, config.colour, POLE_SIDES
    )


def _model(config: ModelConfig, terrain: Terrain) -> Mesh:
    path = settings_path(config.file)
    try:
        triangles, colours = _read(path, config)
    except OSError as error:
        raise ConfigError(f"models in simulator.toml: {describe_os_error(error)}") from None
    except ValueError as error:
        raise ConfigError(f"models in simulator.toml: {path} {error}") from None
    return _placed(triangles, colours, config, terrain)


def _placed(triangles_m: Array, colours: Array, config: BoxConfig | ModelConfig, terrain: Terrain) -> Mesh:
    """Triangles whose axes point forward, right and down, turned and put to their place on the ground."""
    c, s = cos(config.yaw_rad), sin(config.yaw_rad)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    north_m, east_m = config.north_m, config.east_m
    foot_ned_m = np.array((north_m, east_m, -terrain.height_m(north_m, east_m) - config.height_m))
    mesh = mesh_of(triangles_m.astype(np.float64) @ turn.T + foot_ned_m, (0.0, 0.0, 0.0))
    mesh[:, 6:9] = colours
    return mesh


# -- models ----------------------------------------------------------------------------------------------


def _read(path: Path, config: ModelConfig) -> tuple[Array, Array]:
    """(n, 3, 3) corners of a model's triangles, forward, right and down from its origin, and (3n, 3) their colours.

    Raises:
        OSError: the file can't be read.
        ValueError: it is no model of a size and detail that can be used; the text continues the file's name.
    """
    if path.suffix.lower() not in AXES:
        raise ValueError(f"is no model: the formats are {', '.join(AXES)}")
    path.open("rb").close()  # trimesh's own words for a missing file are longer
    import trimesh

    try:
        meshes = [part for part in trimesh.load_scene(path).dump() if isinstance(part, trimesh.Trimesh)]
        parts = [(_triangles(mesh), _colours(mesh, config)) for mesh in meshes if len(mesh.faces)]
    except BROKEN_FILE as error:
        raise ValueError(f"can't be read: {' '.join(str(error).split()) or type(error).__name__}") from error
    if not parts:
        raise ValueError("has no triangles")
    triangles = config.scale * np.concatenate([corners for corners, _ in parts]) @ AXES[path.suffix.lower()].T
    if len(triangles) > MODEL_TRIANGLES_MAX:
        raise ValueError(
            f"has {len(triangles):,} triangles, and {MODEL_TRIANGLES_MAX:,} are the most: make it coarser, in Blender "
            "with the modifier Decimate"
        )
    if not np.isfinite(triangles).all():
        raise ValueError("has corners that are no numbers")
    corners = triangles.reshape(-1, 3)
    size_m = float((corners.max(axis=0) - corners.min(axis=0)).max())
    if not MODEL_SIZE_MIN_M <= size_m <= MODEL_SIZE_MAX_M:
        raise ValueError(
            f"is {size_m:.4g} m large, and {MODEL_SIZE_MIN_M:g} to {MODEL_SIZE_MAX_M:g} m are possible: one unit of "
            "the file is one metre, times `scale`"
        )
    return triangles, np.concatenate([colours for _, colours in parts])


def _triangles(part: Any) -> Array:
    triangles: Array = np.asarray(part.triangles, dtype=np.float64)
    return triangles


def _colours(part: Any, config: ModelConfig) -> Array:
    """(3n, 3) colours of a part's corners: the file's, those of its picture at the corners, or the setting's."""
    visual = part.visual
    if visual.kind == "texture":
        visual = visual.to_color()
    if not visual.defined:
        return np.broadcast_to(np.array(config.colour), (3 * len(part.faces), 3))
    of_vertices = np.asarray(visual.vertex_colors, dtype=np.float64).reshape(-1, 4)[:, :3] / 255.0
    by_corner: Array = np.broadcast_to(of_vertices, (len(part.vertices), 3))[part.faces.ravel()]
    return by_corner


# -- the obstacles as others get them --------------------------------------------------------------------


def obstacle_message(obstacle: StandingObstacle, origin_ned_m: Vec3) -> Obstacle:
    """An obstacle around another origin; one of many triangles as the box around it.

    Args:
        origin_ned_m: (3,) origin of the reply's frame, in the map.
    """
    corners_m = obstacle.corners_ned_m - np.array(origin_ned_m)
    if len(corners_m) > 3 * TRIANGLES_MAX:
        least_m, most_m = obstacle.limits_ned_m - np.array(origin_ned_m)
        middle_m, half_m = 0.5 * (least_m + most_m), 0.5 * (most_m - least_m)
        corners_m = box(tuple(middle_m.tolist()), tuple(half_m.tolist()), (0.0, 0.0, 0.0))[:, :3]
    places, indices = np.unique(np.round(corners_m, 3), axis=0, return_inverse=True)
    red, green, blue = np.round(obstacle.mesh[:, 6:9].mean(axis=0), 3).tolist()
    return Obstacle(
        name=obstacle.name,
        colour=(red, green, blue),
        pos_corners_ned_m=tuple(map(tuple, places.tolist())),
        triangles=tuple((a, b, c) for a, b, c in indices.reshape(-1, 3).tolist()),
    )


def obstacle_place(obstacle: StandingObstacle, origin_ned_m: Vec3) -> ObstaclePlace:
    """Where an obstacle stands, around another origin; what is in the ground doesn't count.

    Args:
        origin_ned_m: (3,) origin of the reply's frame, in the map.
    """
    limits_ned_m = obstacle.limits_ned_m - np.array(origin_ned_m)
    limits_ned_m[1, 2] -= obstacle.sunk_m
    least_m, most_m = np.round(limits_ned_m, 3).tolist()
    north_m, east_m = (round(0.5 * (least_m[i] + most_m[i]), 3) for i in (0, 1))
    long_m, wide_m, tall_m = (round(most - least, 3) for least, most in zip(least_m, most_m, strict=True))
    return ObstaclePlace(
        name=obstacle.name, pos_foot_ned_m=(north_m, east_m, most_m[2]), size_ned_m=(long_m, wide_m, tall_m)
    )


def hidden(triangles_ned_m: Array, eye_ned_m: Array, points_ned_m: Array) -> npt.NDArray[np.bool_]:
    """Which points a triangle hides from the eye.

    Args:
        triangles_ned_m: (n, 3, 3) corners.
        eye_ned_m: (3,) position of the eye.
        points_ned_m: (m, 3) what it looks at.

    Returns:
        (m,) truth values.
    """
    places_m = np.vstack((eye_ned_m, points_ned_m))
    least_m, most_m = places_m.min(axis=0), places_m.max(axis=0)
    between = (triangles_ned_m.max(axis=1) >= least_m) & (triangles_ned_m.min(axis=1) <= most_m)
    near_ned_m = triangles_ned_m[between.all(axis=1)]  # the others can't be in the way
    result: npt.NDArray[np.bool_] = np.logical_or.reduce(_crossings(near_ned_m, eye_ned_m, points_ned_m), axis=1)
    return result


def _crossings(triangles_ned_m: Array, start_ned_m: Array, ends_ned_m: Array) -> npt.NDArray[np.bool_]:
    """Which of n triangles the straight way from the start to each of m ends crosses: (m, n) truth values.

    Source: T. Moeller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    corners_m = triangles_ned_m[:, 0]
    first_m, second_m = triangles_ned_m[:, 1] - corners_m, triangles_ned_m[:, 2] - corners_m
    ways_m = (ends_ned_m - start_ned_m)[:, None]
    across = np.cross(ways_m, second_m)
    volume = (across * first_m).sum(axis=2)
    volume = np.where(np.abs(volume) < 1e-12, np.nan, volume)  # of a triangle that is met edge on
    offset_m = start_ned_m - corners_m
    turned = np.cross(offset_m, first_m)
    u, v = (across * offset_m).sum(axis=2) / volume, (ways_m * turned).sum(axis=2) / volume
    share = (turned * second_m).sum(axis=1) / volume
    crossed: npt.NDArray[np.bool_] = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (share > 0.0) & (share < 1.0)
    return crossed
