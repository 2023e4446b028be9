"""The simulated world in OpenGL: ground, rocks, obstacles, rover and the shadows of all that stands on the ground."""

from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import moderngl
import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.sensors import CameraInfo
from jezero.services.simulator.camera.board import board_picture
from jezero.services.simulator.camera.gl_matrices import clip_from_sun
from jezero.services.simulator.camera.ground import FINE_SIDE_M, SIDE_M, ground_textures
from jezero.services.simulator.camera.meshes import rocks_mesh, rover_mesh, scenery_meshes, uav_mesh
from jezero.services.simulator.camera.sun import TO_SUN_NED
from jezero.services.simulator.camera.view import CameraView, half_tangents
from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.shapes import Mesh
from jezero.services.simulator.terrain import HALF_SIDE_M, POINTS, SPACING_M, Terrain, make_terrain

SHADERS = Path(__file__).with_name("shaders")
SHADOW_TEXELS = 1024
SHADOW_DEPTH_M = 25.0
SHADOW_BIAS_TEXELS = 2.0
"""Keeps a surface out of the shadow of its own neighbourhood."""
HAZE_PER_M = 1.0 / 900.0
FINE_AGAIN = 4.7
"""The fine texture is repeated at a scale smaller by this factor, so that no period is visible."""
COARSE_UNIT, FINE_UNIT, BOARD_UNIT, SHADOW_UNIT = range(4)


class Body(NamedTuple):
    """One mesh, for the picture and for its shadow."""

    seen: moderngl.VertexArray
    dark: moderngl.VertexArray


class Placed(NamedTuple):
    """Poses of rover and vehicle; None leaves one of them out."""

    ned_from_rover: Array | None
    ned_from_uav: Array | None


class GlWorld:
    """Textures, meshes and programs in one context.

    Attributes:
        shows_uav: whether the vehicle is drawn; it is never in the picture of its own camera.
    """

    def __init__(self, gl: moderngl.Context, config: TerrainConfig, vehicle: VehicleConfig) -> None:
        self._gl = gl
        self.shows_uav = False
        self._kept: list[moderngl.Texture] = []
        terrain = make_terrain(config)
        self._make_programs(vehicle.platform.side_m)
        textures = ground_textures(config)
        self._texture(textures.coarse, COARSE_UNIT)
        self._texture(textures.fine, FINE_UNIT)
        self._texture(board_picture(vehicle.platform), BOARD_UNIT)
        self._shadow_map = gl.depth_texture((SHADOW_TEXELS, SHADOW_TEXELS))
        self._shadow_map.compare_func = "<="
        self._shadow_map.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self._shadow_target = gl.framebuffer(depth_attachment=self._shadow_map)
        self.ground = make_ground_mesh(terrain)
        vertices, indices = gl.buffer(self.ground.vertices.tobytes()), gl.buffer(self.ground.indices.tobytes())
        layout = [(vertices, "3f 3f", "in_position", "in_normal")]
        self._ground = gl.vertex_array(self._ground_program, layout, indices)
        rocks = rocks_mesh(terrain)
        self._rocks = self._body(rocks, self._rock_program) if len(rocks) else None
        scenery = scenery_meshes(config, terrain)
        self._scenery = self._body(np.concatenate(scenery), self._body_program) if scenery else None
        self._rover = self._body(rover_mesh(vehicle.platform, vehicle.uwb), self._body_program)
        self._board = self._body(_top(vehicle.platform.side_m), self._board_program)
        self._uav = self._body(uav_mesh(vehicle.airframe), self._body_program)

    # -- building --

    def program(self, vertex: str, fragment: str) -> moderngl.Program:
        """A program from two files of the folder with the shaders."""
        light = (SHADERS / "light.glsl").read_text()
        sources = [(SHADERS / name).read_text().replace("#include light.glsl", light) for name in (vertex, fragment)]
        return self._gl.program(vertex_shader=sources[0], fragment_shader=sources[1])

    def _make_programs(self, side_platform_m: float) -> None:
        self._ground_program = self.program("ground.vert", "ground.frag")
        self._body_program = self.program("body.vert", "body.frag")
        self._rock_program = self.program("body.vert", "rock.frag")
        self._board_program = self.program("body.vert", "board.frag")
        self._shadow_program = self.program("shadow.vert", "shadow.frag")
        self._lit = (self._ground_program, self._body_program, self._rock_program, self._board_program)
        for program in self._lit:
            program["to_sun"] = TO_SUN_NED
            program["shadow_map"] = SHADOW_UNIT
        self._ground_program["coarse"] = COARSE_UNIT
        self._ground_program["fine"] = FINE_UNIT
        self._ground_program["coarse_per_m"] = 1.0 / SIDE_M
        self._ground_program["fine_per_m"] = (1.0 / FINE_SIDE_M, FINE_AGAIN / FINE_SIDE_M)
        self._rock_program["fine"] = FINE_UNIT
        self._board_program["board"] = BOARD_UNIT
        self._board_program["side"] = side_platform_m

    def _texture(self, picture: npt.NDArray[np.uint8], unit: int) -> None:
        rows, columns, channels = picture.shape
        texture = self._gl.texture((columns, rows), channels, np.ascontiguousarray(picture).tobytes(), alignment=1)
        texture.build_mipmaps()
        smooth = unit == BOARD_UNIT  # the ground is the dearest part of a picture, and hides the steps
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR if smooth else moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR)
        texture.use(unit)
        self._kept.append(texture)

    def _body(self, mesh: Mesh, program: moderngl.Program) -> Body:
        corners = self._gl.buffer(mesh.tobytes())
        names = ["in_position", "in_normal", "in_colour"]
        used = [name for name in names if name in program]
        layout = "3f " * len(used) + ("12x " * (3 - len(used)))
        seen = self._gl.vertex_array(program, [(corners, layout.strip(), *used)])
        dark = self._gl.vertex_array(self._shadow_program, [(corners, "3f 24x", "in_position")])
        return Body(seen, dark)

    # -- drawing --

    def cast_shadows(self, middle_ned_m: Vec3, reach_m: float, placed: Placed) -> None:
        """Make the shadows on the ground within `reach_m` of a point; there are none beyond."""
        depth_m = reach_m + SHADOW_DEPTH_M
        bias_m = SHADOW_BIAS_TEXELS * 2.0 * reach_m / SHADOW_TEXELS
        matrix = clip_from_sun(TO_SUN_NED, middle_ned_m, reach_m, depth_m)
        program = self._shadow_program
        self._shadow_target.use()
        self._shadow_target.clear(depth=1.0)
        put(program["clip_from_ned"], matrix)
        casters = [
            (self._rocks, np.eye(4)),
            (self._scenery, np.eye(4)),
            (self._rover, placed.ned_from_rover),
            (self._uav, placed.ned_from_uav),
        ]
        for body, pose in casters:
            if body is not None and pose is not None:
                put(program["ned_from_body"], pose)
                body.dark.render(moderngl.TRIANGLES)
        self._shadow_map.use(SHADOW_UNIT)
        for lit in self._lit:
            put(lit["shadow_from_ned"], matrix)
            lit["shadow_bias"] = bias_m / (2.0 * depth_m)

    def draw(self, clip_from_ned: Array, eye_ned_m: Vec3, pieces: list[int], placed: Placed, haze_per_m: float) -> None:
        """Draw all but the sky, the nearest first.

        Args:
            pieces: indices of the ground's pieces to draw.
        """
        for program in self._lit:
            put(program["clip_from_ned"], clip_from_ned)
            program["eye"] = eye_ned_m
            program["haze_per_m"] = haze_per_m
        if placed.ned_from_rover is not None:
            put(self._board_program["ned_from_body"], placed.ned_from_rover)
            self._board.seen.render(moderngl.TRIANGLE_STRIP)
            put(self._body_program["ned_from_body"], placed.ned_from_rover)
            self._body_program["moves"] = 1.0
            self._rover.seen.render(moderngl.TRIANGLES)
        self._body_program["moves"] = 0.0
        if self.shows_uav and placed.ned_from_uav is not None:
            put(self._body_program["ned_from_body"], placed.ned_from_uav)
            self._uav.seen.render(moderngl.TRIANGLES)
        if self._scenery is not None:
            put(self._body_program["ned_from_body"], np.eye(4))
            self._scenery.seen.render(moderngl.TRIANGLES)
        if self._rocks is not None:
            put(self._rock_program["ned_from_body"], np.eye(4))
            self._rocks.seen.render(moderngl.TRIANGLES)
        length = self.ground.piece_length
        for piece in pieces:
            self._ground.render(moderngl.TRIANGLES, vertices=length, first=piece * length)
        apron = self.ground.apron_length
        self._ground.render(moderngl.TRIANGLES, vertices=apron, first=len(self.ground.indices) - apron)


def put(uniform: Any, matrix: Array) -> None:
    """Set a matrix, in OpenGL's order of columns."""
    uniform.write(np.ascontiguousarray(matrix.T, dtype=np.float32).tobytes())


def _top(side_m: float) -> Mesh:
    """The platform's upper face as a strip of two triangles."""
    half_m = 0.5 * side_m
    corners = ((half_m, -half_m), (half_m, half_m), (-half_m, -half_m), (-half_m, half_m))
    return np.array([(a, b, 0.0, 0.0, 0.0, -1.0, 1.0, 1.0, 1.0) for a, b in corners], dtype=np.float32)


# -- the ground: triangles in pieces, of which only those in the picture are drawn -----------------------

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
