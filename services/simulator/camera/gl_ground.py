"""The terrain as triangles, in pieces of which only those in the picture are drawn."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.schemas.sensors import CameraInfo
from jezero.services.simulator.camera.view import CameraView, half_tangents
from jezero.services.simulator.terrain import HALF_SIDE_M, POINTS, SPACING_M, Terrain

SQUARES = 15
"""Squares along the side of a piece."""
PIECES = (POINTS - 1) // SQUARES
APRON_M = 3000.0
REACH_M = 0.5 * SQUARES * SPACING_M * sqrt(2.0) + 0.5
"""Greatest distance of a point of a piece from its middle."""


@dataclass(frozen=True)
class GroundMesh:
    """Attributes:
    vertices: (n, 6) position and normal in the map.
    indices: of all pieces' triangles, one piece after the other; last the level apron around the terrain.
    middles_m: (pieces, 3)
    piece_length, apron_length: of each piece and of the apron, in indices.
    """

    vertices: npt.NDArray[np.float32]
    indices: npt.NDArray[np.uint32]
    middles_m: Array
    piece_length: int
    apron_length: int

    def pieces_in_picture(self, view: CameraView, info: CameraInfo) -> list[int]:
        """Indices of the pieces that may be in the picture, the nearest first."""
        in_camera = (self.middles_m - np.array(view.pos_camera_ned_m)) @ view.rotation_ned_from_camera
        across, along = half_tangents(info)
        right, down, forward = np.abs(in_camera[:, 0]), np.abs(in_camera[:, 1]), in_camera[:, 2]
        visible = (
            (forward > -REACH_M)
            & (right < across * forward + REACH_M * sqrt(1.0 + across * across))
            & (down < along * forward + REACH_M * sqrt(1.0 + along * along))
        )
        order: list[int] = np.flatnonzero(visible)[np.argsort(forward[visible])].tolist()
        return order


def make_ground_mesh(terrain: Terrain) -> GroundMesh:
    """The mesh of a terrain, with smooth normals."""
    axis_m = np.linspace(-HALF_SIDE_M, HALF_SIDE_M, POINTS)
    north_m, east_m = np.meshgrid(axis_m, axis_m, indexing="ij")
    slope_north, slope_east = np.gradient(terrain.heights_m, SPACING_M)
    normals = np.stack([-slope_north, -slope_east, -np.ones_like(slope_north)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points = np.concatenate([np.stack([north_m, east_m, -terrain.heights_m], axis=-1), normals], axis=-1)
    rows, columns = np.meshgrid(np.arange(SQUARES), np.arange(SQUARES), indexing="ij")
    a = rows * POINTS + columns
    b, c, d = a + POINTS, a + POINTS + 1, a + 1
    piece = np.stack([a, b, c, a, c, d], axis=-1).ravel()
    corners = [(i, j) for i in range(PIECES) for j in range(PIECES)]
    side_m = SQUARES * SPACING_M
    middles = [(side_m * (i + 0.5) - HALF_SIDE_M, side_m * (j + 0.5) - HALF_SIDE_M, 0.0) for i, j in corners]
    apron, around = _apron(POINTS * POINTS)
    return GroundMesh(
        vertices=np.concatenate([points.reshape(-1, 6), apron]).astype(np.float32),
        indices=np.concatenate([*(piece + SQUARES * (i * POINTS + j) for i, j in corners), around]).astype(np.uint32),
        middles_m=np.array(middles),
        piece_length=piece.size,
        apron_length=around.size,
    )


def _apron(first: int) -> tuple[Array, npt.NDArray[np.int64]]:
    """Level ground from the terrain's edge outwards: vertices, and indices when the vertices start at `first`."""
    signs = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    squares = [(a * side_m, b * side_m) for side_m in (HALF_SIDE_M + APRON_M, HALF_SIDE_M) for a, b in signs]
    vertices = np.array([(north_m, east_m, 0.0, 0.0, 0.0, -1.0) for north_m, east_m in squares])
    quads = ((0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    return vertices, first + np.array([k for a, b, c, d in quads for k in (a, b, c, a, c, d)])
