"""Pictures by PyBullet's TinyRenderer, which needs no OpenGL: plainer, without shadows, about 5 per second.

Its world is in NED too: the renderer assumes no direction of its axes.
"""

import tempfile
import weakref
from math import hypot
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.base.vehicle_config import PlatformConfig, VehicleConfig
from jezero.schemas.sensors import CameraInfo
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.board import board_picture
from jezero.services.simulator.camera.exposure import Image, PixelNoise
from jezero.services.simulator.camera.ground import FINE_SIDE_M, SIDE_M, ground_textures
from jezero.services.simulator.camera.meshes import rocks_mesh, rover_mesh, scenery_meshes
from jezero.services.simulator.camera.sun import TO_SUN_NED
from jezero.services.simulator.camera.view import CameraView, project
from jezero.services.simulator.config import TerrainConfig
from jezero.services.simulator.quiet_pybullet import pybullet
from jezero.services.simulator.shapes import Mesh
from jezero.services.simulator.terrain import HALF_SIDE_M, POINTS, SPACING_M, Terrain, make_terrain

NEAR_M, FAR_M = 0.02, 400.0
THINNING = 3
"""Only every third point of the terrain is used, as the renderer is slow with many triangles."""
BOARD_TEXELS = 1000
BLUR_FROM_PX = 1.0
STD_LENS_PX = 0.6
"""Blur of a lens, which also smooths the renderer's jagged edges."""
SKY_LOW, SKY_HIGH = np.array((200.0, 172.0, 146.0)), np.array((164.0, 138.0, 116.0))


class TinyRenderer:
    """Renders one camera's pictures on the processor."""

    rate_max_hz = 5.0

    description = (
        "rendering with PyBullet's TinyRenderer: for better pictures install libegl1, libgl1 and libgl1-mesa-dri"
    )

    def __init__(self, config: TerrainConfig, vehicle: VehicleConfig, noise: PixelNoise) -> None:
        self._info = info = vehicle.camera.info(0)
        self._noise = noise
        self._client = int(pybullet.connect(pybullet.DIRECT))
        weakref.finalize(self, pybullet.disconnect, physicsClientId=self._client)
        self._projection = _projection(info)
        terrain = make_terrain(config)
        with tempfile.TemporaryDirectory() as folder:
            self._folder = Path(folder)
            self._add(_ground_mesh(terrain), self._texture(_ground_picture(config)))
            rocks = rocks_mesh(terrain, divisions=0)
            if len(rocks):
                self._add_painted(rocks)
            for mesh in scenery_meshes(config, terrain):
                self._add_painted(mesh)
            self._rover = [
                self._add_painted(rover_mesh(vehicle.platform, vehicle.uwb)),
                self._add(_top_mesh(vehicle.platform.side_m), self._texture(_top_picture(vehicle.platform))),
            ]

    def picture(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> bytes:
        """The picture of a scene, blurred as much as its middle moves, with noise."""
        view = views[1]
        w, x, y, z = view.q_ned_from_rover_body
        for body in self._rover:
            pybullet.resetBasePositionAndOrientation(
                body, view.pos_rover_ned_m, (x, y, z, w), physicsClientId=self._client
            )
        info = self._info
        _, _, colours, depth, _ = pybullet.getCameraImage(
            info.width_px,
            info.height_px,
            viewMatrix=_view_matrix(view),
            projectionMatrix=self._projection,
            lightDirection=TO_SUN_NED,
            lightColor=(1.0, 0.95, 0.88),
            lightDistance=50.0,
            lightAmbientCoeff=0.45,
            lightDiffuseCoeff=0.62,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            physicsClientId=self._client,
        )
        shape = (info.height_px, info.width_px)
        picture = np.ascontiguousarray(np.asarray(colours, dtype=np.uint8).reshape(*shape, 4)[..., :3])
        _paint_sky(picture, np.asarray(depth).reshape(shape) >= 1.0, view, info)
        through_lens = np.asarray(cv2.GaussianBlur(picture, (0, 0), STD_LENS_PX), dtype=np.uint8)
        return self._noise.add(_blurred(through_lens, views, info)).tobytes()

    # -- building --

    def _texture(self, picture: Image) -> int:
        path = self._folder / f"{len(list(self._folder.iterdir()))}.png"  # the renderer caches textures by file name
        cv2.imwrite(str(path), picture[::-1, :, ::-1])
        return int(pybullet.loadTexture(str(path), physicsClientId=self._client))

    def _add(self, mesh: Mesh, texture: int) -> int:
        """A body of a mesh whose last columns are (u, v, -) instead of colours."""
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=mesh[:, :3].tolist(),
            indices=list(range(len(mesh))),
            normals=mesh[:, 3:6].tolist(),
            uvs=mesh[:, 6:8].tolist(),
            rgbaColor=(1.0, 1.0, 1.0, 1.0),
            specularColor=(0.0, 0.0, 0.0),
            physicsClientId=self._client,
        )
        body = int(pybullet.createMultiBody(0.0, -1, shape, physicsClientId=self._client))
        pybullet.changeVisualShape(body, -1, textureUniqueId=texture, physicsClientId=self._client)
        return body

    def _add_painted(self, mesh: Mesh) -> int:
        """A body with a colour for each face: they become a strip of texels."""
        colours, which = np.unique(mesh[:, 6:9], axis=0, return_inverse=True)
        palette = np.repeat(np.clip(255.0 * colours, 0.0, 255.0).astype(np.uint8)[None], 4, axis=0)
        placed = mesh.copy()
        placed[:, 6] = (which.ravel() + 0.5) / len(colours)
        placed[:, 7] = 0.5
        return self._add(placed, self._texture(palette))


def _projection(info: CameraInfo) -> tuple[float, ...]:
    """OpenGL's projection by columns, moved half a pixel to the left and down, where the renderer samples pixels."""
    across, along = 2.0 * info.focal_px / info.width_px, 2.0 * info.focal_px / info.height_px
    a, b = (FAR_M + NEAR_M) / (NEAR_M - FAR_M), 2.0 * FAR_M * NEAR_M / (NEAR_M - FAR_M)
    left, below = 1.0 / info.width_px, 1.0 / info.height_px
    return (across, 0.0, 0.0, 0.0, 0.0, along, 0.0, 0.0, left, below, a, -1.0, 0.0, 0.0, b, 0.0)


def _view_matrix(view: CameraView) -> tuple[float, ...]:
    """OpenGL's view matrix by columns; its camera points along -z with y up."""
    rotation = np.diag((1.0, -1.0, -1.0)) @ view.rotation_ned_from_camera.T
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = -rotation @ np.array(view.pos_camera_ned_m)
    return tuple(matrix.T.ravel().tolist())


def _ground_mesh(terrain: Terrain) -> Mesh:
    """The terrain from some of its points, and a level ring around it; with places in the repeating picture."""
    axis_m = np.linspace(-HALF_SIDE_M, HALF_SIDE_M, POINTS)[::THINNING]
    heights_m = terrain.heights_m[::THINNING, ::THINNING]
    axis_m = np.concatenate([[-FAR_M], axis_m, [FAR_M]])
    heights_m = np.pad(heights_m, 1)
    slope_north, slope_east = np.gradient(heights_m, SPACING_M * THINNING)
    north_m, east_m = np.meshgrid(axis_m, axis_m, indexing="ij")
    normals = np.stack([-slope_north, -slope_east, -np.ones_like(slope_north)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    places = (np.stack([east_m, north_m], axis=-1) + 2.0 * FAR_M) / _PICTURE_SIDE_M
    corners = np.concatenate(
        [np.stack([north_m, east_m, -heights_m], axis=-1), normals, places, np.zeros((*north_m.shape, 1))], axis=-1
    )
    a, b, c, d = corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]
    return np.stack([a, c, b, a, d, c], axis=2).reshape(-1, 9).astype(np.float32)


_PICTURE_SIDE_M = 2.0 * FINE_SIDE_M


def _ground_picture(config: TerrainConfig) -> Image:
    """(2048, 2048, 3) the ground's colours at the map's middle, as the sun lights them."""
    textures = ground_textures(config)
    texels = 2 * len(textures.fine)
    first, last = (round((0.5 + share * FINE_SIDE_M / SIDE_M) * len(textures.coarse)) for share in (-0.5, 0.5))
    tint = textures.coarse[first:last, first:last]
    tint = np.vstack([tint, tint[::-1]])
    tint = np.hstack([tint, tint[:, ::-1]])
    fine = np.tile(textures.fine, (2, 2, 1)).astype(np.float32)
    slopes = (fine[..., :2] - 127.5) / 127.0
    facing = -TO_SUN_NED[2] - TO_SUN_NED[0] * slopes[..., 0] - TO_SUN_NED[1] * slopes[..., 1]
    light = (fine[..., 2] / 127.5) * np.sqrt(0.35 + 0.85 * np.clip(facing, 0.0, 1.2) * fine[..., 3] / 255.0)
    colours = cv2.resize(tint, (texels, texels), interpolation=cv2.INTER_LINEAR) * (1.1 * light[..., None])
    return np.clip(colours, 0.0, 255.0).astype(np.uint8)


def _top_mesh(side_m: float) -> Mesh:
    half_m = 0.5 * side_m
    corners = [(a, b, -0.001, 0.0, 0.0, -1.0, b / side_m + 0.5, 0.5 + a / side_m, 0.0)
               for a, b in ((half_m, -half_m), (half_m, half_m), (-half_m, half_m), (-half_m, -half_m))]  # fmt: skip
    return np.array([corners[i] for i in (0, 2, 1, 0, 3, 2)], dtype=np.float32)


def _top_picture(platform: PlatformConfig) -> Image:
    painted = board_picture(platform)
    picture = cv2.resize(painted, (BOARD_TEXELS, BOARD_TEXELS), interpolation=cv2.INTER_AREA)
    return np.asarray(picture, dtype=np.uint8)[::-1]


def _paint_sky(picture: Image, is_sky: npt.NDArray[np.bool_], view: CameraView, info: CameraInfo) -> None:
    """Paint the sky, paler towards the horizon, into the pixels that show nothing else."""
    if not is_sky.any():
        return
    rows, columns = np.nonzero(is_sky)
    right, down = (columns - info.center_px[0]) / info.focal_px, (rows - info.center_px[1]) / info.focal_px
    rays: Array = np.stack([right, down, np.ones_like(right)], axis=-1)
    up = -(rays @ view.rotation_ned_from_camera[2]) / np.linalg.norm(rays, axis=1)
    share = np.clip(1.0 - np.exp(-3.0 * np.maximum(up, 0.0)), 0.0, 1.0)[:, None]
    picture[rows, columns] = (SKY_LOW + share * (SKY_HIGH - SKY_LOW)).astype(np.uint8)


def _blurred(picture: Image, views: tuple[CameraView, CameraView, CameraView], info: CameraInfo) -> Image:
    """The whole picture, blurred along the motion of the platform's middle in it."""
    point = np.array(views[1].pos_rover_ned_m)
    moves = 0.5 * (np.array(views[2].pos_rover_ned_m) - np.array(views[0].pos_rover_ned_m))
    way = project(point + moves, views[2], info) - project(point - moves, views[0], info)
    if not np.isfinite(way).all() or hypot(*way) < BLUR_FROM_PX:
        return picture
    half = 0.5 * np.clip(way, -60.0, 60.0)
    reach = int(np.ceil(np.abs(half).max())) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    scale = 16.0
    ends = [tuple(np.round((reach + sign * half) * scale).astype(int).tolist()) for sign in (-1.0, 1.0)]
    cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_AA, 4)
    return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum()), dtype=np.uint8)
