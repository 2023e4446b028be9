"""What rocks, rover and vehicle look like.

Rover and vehicle are of about the size of the bodies that the physics collides with, and finer.
"""

from math import cos, pi, sin

import numpy as np

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PLATFORM_THICKNESS_M, AirframeConfig, PlatformConfig, UwbLayoutConfig
from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.noise import generator
from jezero.services.simulator.obstacles import make_obstacles
from jezero.services.simulator.rover import WHEEL_FORWARD_M, WHEEL_RADIUS_PER_HEIGHT, WHEEL_SIDE_M, WHEEL_WIDTH_M
from jezero.services.simulator.shapes import Colour, Mesh, box, mesh_of, rod
from jezero.services.simulator.terrain import Terrain

WHITE: Colour = (0.86, 0.85, 0.82)
GREY: Colour = (0.52, 0.52, 0.53)
DARK: Colour = (0.20, 0.20, 0.22)
GOLD: Colour = (0.78, 0.56, 0.24)
BLUE: Colour = (0.14, 0.20, 0.44)
ORANGE: Colour = (0.86, 0.36, 0.12)
WATER: Colour = (0.24, 0.33, 0.36)
WATER_DOWN_M = 0.1
"""Water is drawn lower than its level by this, so that the pier at the start is dry."""
WATER_HALF_SIDE_M = 300.0


def rover_mesh(platform: PlatformConfig, uwb: UwbLayoutConfig) -> Mesh:
    """Platform, chassis, six wheels on rockers, in `rover_body`; its top face is painted by the board's picture."""
    half_m, top_m = 0.5 * platform.side_m, platform.height_m
    thick_m = 0.5 * PLATFORM_THICKNESS_M
    parts = [
        box((0.0, 0.0, thick_m + 0.002), (half_m, half_m, thick_m), GREY),
        box((0.0, 0.0, 0.38 * top_m), (0.42, 0.26, 0.22 * top_m), WHITE),
        box((0.30, 0.0, 0.64 * top_m), (0.14, 0.18, 0.06 * top_m), GOLD),
        rod((-0.40, 0.0, 0.34 * top_m), (-0.60, 0.0, 0.26 * top_m), 0.075, DARK, 12),
        box((-0.52, 0.0, 0.30 * top_m), (0.10, 0.012, 0.17 * top_m), GREY, 0.35),
        box((0.0, -0.31, 0.30 * top_m), (0.30, 0.015, 0.10 * top_m), BLUE),
        box((0.0, 0.31, 0.30 * top_m), (0.30, 0.015, 0.10 * top_m), BLUE),
    ]
    parts += [rod((x, y, thick_m), (x, y, -0.012), 0.018, ORANGE, 10) for x, y, _ in uwb.pos_anchors_rover_body_m]
    for side in (-1.0, 1.0):
        parts += _wheels(side, top_m)
    return np.concatenate(parts)


def _corners(at_m: float) -> list[tuple[float, float]]:
    return [(a * at_m, b * at_m) for a in (1.0, -1.0) for b in (1.0, -1.0)]


def _wheels(side: float, top_m: float) -> list[Mesh]:
    """Three wheels of one side, with treads, hubs, and the rocker that holds them."""
    radius_m, half_m = WHEEL_RADIUS_PER_HEIGHT * top_m, 0.5 * WHEEL_WIDTH_M
    axle_m = top_m - radius_m
    parts = [
        rod((0.06, side * 0.40, 0.45 * top_m), (0.47, side * 0.44, axle_m - 0.03), 0.022, GREY),
        rod((0.06, side * 0.40, 0.45 * top_m), (-0.22, side * 0.42, 0.62 * top_m), 0.022, GREY),
        rod((-0.22, side * 0.42, 0.62 * top_m), (0.0, side * 0.44, axle_m), 0.02, GREY),
        rod((-0.22, side * 0.42, 0.62 * top_m), (-0.47, side * 0.44, axle_m), 0.02, GREY),
    ]
    for forward_m in (WHEEL_FORWARD_M, 0.0, -WHEEL_FORWARD_M):
        middle = (forward_m, side * WHEEL_SIDE_M, axle_m)
        for reach_m, radius, colour, sides in ((half_m, radius_m, DARK, 20), (half_m + 0.008, 0.045, GREY, 12)):
            ends = [(forward_m, side * (WHEEL_SIDE_M + sign * reach_m), axle_m) for sign in (-1.0, 1.0)]
            parts.append(rod(ends[0], ends[1], radius, colour, sides))
        for k in range(20):
            angle = 2.0 * pi * k / 20
            place = (middle[0] + radius_m * cos(angle), middle[1], middle[2] - radius_m * sin(angle))
            parts.append(box(place, (0.007, 0.062, 0.006), (0.3, 0.29, 0.29), angle + 0.5 * pi))
    return parts


def uav_mesh(airframe: AirframeConfig) -> Mesh:
    """Hull, arms, legs and two blades per rotor, in the vehicle's FRD."""
    parts = [
        box((0.0, 0.0, -0.01), (0.15, 0.09, 0.035), WHITE),
        box((-0.02, 0.0, -0.055), (0.10, 0.06, 0.012), DARK),
    ]
    for index, (forward_m, right_m) in enumerate(airframe.pos_rotors_frd_m):
        hub = (forward_m, right_m, -0.05)
        parts.append(rod((0.3 * forward_m, 0.3 * right_m, -0.02), (forward_m, right_m, -0.025), 0.013, DARK))
        parts.append(rod((forward_m, right_m, 0.0), hub, 0.02, GREY))
        angle = 0.7 + 1.9 * index
        along = (airframe.radius_rotor_m * cos(angle), airframe.radius_rotor_m * sin(angle))
        tips = [(hub[0] + sign * along[0], hub[1] + sign * along[1], -0.055) for sign in (-1.0, 1.0)]
        parts.append(rod((tips[0][0], tips[0][1], -0.055), (tips[1][0], tips[1][1], -0.055), 0.012, DARK, 4))
    forward_m, right_m = airframe.feet_frd_m
    for a, b in _corners(1.0):
        foot = (a * forward_m, b * right_m, airframe.height_stand_m - 0.01)
        parts.append(rod((0.7 * a * forward_m, 0.6 * b * right_m, 0.0), foot, 0.009, DARK))
    return np.concatenate(parts)


def scenery_meshes(config: TerrainConfig, terrain: Terrain) -> list[Mesh]:
    """Obstacles, and the surface of the water, in the map.

    Raises:
        ConfigError: the file of a model can't be used.
    """
    meshes = [obstacle.mesh for obstacle in make_obstacles(config, terrain)]
    if config.water_depth_m:
        meshes.append(box((0.0, 0.0, WATER_DOWN_M + 1.0), (WATER_HALF_SIDE_M, WATER_HALF_SIDE_M, 1.0), WATER))
    return meshes


def rocks_mesh(terrain: Terrain, divisions: int = 2) -> Mesh:
    """The simulator's rocks in the map, each face divided into 4^divisions and roughened."""
    if not len(terrain.rock_faces):
        return np.zeros((0, 9), dtype=np.float32)
    rng = generator(1, "rocks")
    corners = terrain.rock_vertices_ned_m[terrain.rock_faces]
    parts = []
    for faces in corners.reshape(-1, 20, 3, 3):
        fine = faces
        for _ in range(divisions):
            fine = _divided(fine)
        fine = _roughened(fine, faces.reshape(-1, 3).mean(axis=0), rng)
        tone = rng.uniform(0.8, 1.15)
        colour = (0.46 * tone, 0.35 * tone, 0.28 * tone)
        parts.append(_smoothed(mesh_of(fine, colour)))
    return np.concatenate(parts)


def _divided(triangles: Array) -> Array:
    """Each triangle as four."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(corners, axis=1) for corners in quarters])


def _roughened(triangles: Array, middle: Array, rng: np.random.Generator) -> Array:
    """Each corner moved by some waves of its direction; equal corners stay equal."""
    offsets = triangles - middle
    lengths = np.linalg.norm(offsets, axis=-1, keepdims=True)
    directions = offsets / np.maximum(lengths, 1e-9)
    rough = np.zeros(lengths.shape)
    for frequency, amplitude in ((3.0, 0.07), (7.0, 0.05), (15.0, 0.025)):
        wave = rng.normal(0.0, frequency, 3)
        rough += amplitude * np.sin(directions @ wave + rng.uniform(0.0, 2.0 * pi))[..., None]
    result: Array = middle + offsets * (0.98 + rough)
    return result


def _smoothed(mesh: Mesh) -> Mesh:
    """Normals half way between those of the faces and those of a smooth surface."""
    keys = np.round(mesh[:, :3] * 1e4).astype(np.int64)
    _, which = np.unique(keys, axis=0, return_inverse=True)
    sums = np.zeros((which.max() + 1, 3), dtype=np.float32)
    np.add.at(sums, which.ravel(), mesh[:, 3:6])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    mesh[:, 3:6] = 0.45 * mesh[:, 3:6] + 0.55 * sums[which.ravel()]
    return mesh
