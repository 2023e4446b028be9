"""Pictures by OpenGL on EGL: with a graphics card, or on the processor alone with Mesa's llvmpipe."""

import weakref
from typing import Any

import moderngl
import numpy as np

from jezero.base.arrays import Array
from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.exposure import Image, PixelNoise, moved_px
from jezero.services.simulator.camera.gl_matrices import (
    camera_from_ned,
    clip_from_above,
    clip_from_camera,
    ned_from_frd,
    ned_from_rover_body,
)
from jezero.services.simulator.camera.gl_world import HAZE_PER_M, GlWorld, Placed, put
from jezero.services.simulator.camera.service import NoEglError
from jezero.services.simulator.camera.sun import TO_SUN_NED
from jezero.services.simulator.camera.view import CameraView, half_tangents
from jezero.services.simulator.config import TerrainConfig

NEAR_M, FAR_M = 0.02, 4000.0
BLUR_FROM_PX = 0.5
TAPS_MAX = 10
SHARP_UNIT, DEPTH_UNIT = 4, 5
SIGHT_MAX_M = 25.0
"""Greatest distance at which a camera that points to the horizon has shadows in its picture."""
ON_PLATFORM_M = 1.5
"""Within this distance of the platform's middle the platform is the surface in the picture, else the ground."""


class EglRenderer:
    """Renders one camera's pictures, and views of the ground from above.

    Attributes:
        world: all that can be in the picture.

    Raises:
        NoEglError: there is no OpenGL.
    """

    rate_max_hz = 60.0

    def __init__(self, terrain: TerrainConfig, vehicle: VehicleConfig, noise: PixelNoise) -> None:
        try:
            options: dict[str, Any] = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
            gl = moderngl.create_context(standalone=True, **options)
        except Exception as error:  # noqa: BLE001 - moderngl raises bare exceptions for whatever EGL says
            raise NoEglError(f"no OpenGL on EGL: {error}") from None
        self._gl = gl
        weakref.finalize(self, gl.release)
        self.description = f"rendering with EGL on {gl.info['GL_RENDERER']}"
        self._info = info = vehicle.camera.info(0)
        self._noise = noise
        self._clip_from_camera = clip_from_camera(info, NEAR_M, FAR_M)
        self.world = GlWorld(gl, terrain, vehicle)
        self._sky_program = self.world.program("screen.vert", "sky.frag")
        self._sky_program["to_sun"] = TO_SUN_NED
        self._blur_program = self.world.program("screen.vert", "blur.frag")
        self._blur_program["sharp"] = SHARP_UNIT
        self._blur_program["depth"] = DEPTH_UNIT
        self._make_targets((info.width_px, info.height_px))
        gl.enable(moderngl.DEPTH_TEST)

    def _make_targets(self, size: tuple[int, int]) -> None:
        gl = self._gl
        self._sharp = gl.texture(size, 4)
        self._sharp.repeat_x = self._sharp.repeat_y = False
        self._depth = gl.depth_texture(size)
        self._depth.compare_func = ""
        self._depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._target = gl.framebuffer([self._sharp], self._depth)
        self._blurred = gl.framebuffer([gl.texture(size, 4)])
        corners = gl.buffer(np.array([(-1, -1), (3, -1), (-1, 3)], dtype=np.float32).tobytes())
        self._sky = gl.vertex_array(self._sky_program, [(corners, "2f", "in_corner")])
        self._blur = gl.vertex_array(self._blur_program, [(corners, "2f", "in_corner")])

    def picture(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> bytes:
        """The picture of a scene, blurred by the motion from the first view to the last, with noise."""
        view = views[1]
        placed = Placed(ned_from_rover_body(view), ned_from_frd(scene.pos_uav_ned_m, scene.q_ned_from_frd))
        middle_ned_m, reach_m = _shadow_area(view)
        self.world.cast_shadows(middle_ned_m, reach_m, placed)
        clip_from_ned = self._clip_from_camera @ camera_from_ned(view)
        self._target.use()
        self._target.clear(depth=1.0)
        pieces = self.world.ground.pieces_in_picture(view, self._info)
        self.world.draw(clip_from_ned, view.pos_camera_ned_m, pieces, placed, HAZE_PER_M)
        self._draw_sky(view)
        source = self._target
        moved = moved_px(views, self._info)
        if moved > BLUR_FROM_PX:
            self._blur_by(moved, views, clip_from_ned)
            source = self._blurred
        return self._noise.add(_read(source)).tobytes()

    def orthophoto(self, middle_ned_m: Vec3, side_m: float, texels: int) -> Image:
        """(texels, texels, 3) a square of the bare ground straight from above, north at the top."""
        half_m = 0.5 * side_m
        target = self._gl.simple_framebuffer((texels, texels), 4)
        nobody = Placed(None, None)
        self.world.cast_shadows(middle_ned_m, 1.5 * half_m + 1.0, nobody)
        target.use()
        target.clear(depth=1.0)
        north_m, east_m, down_m = middle_ned_m
        above = (north_m, east_m, down_m - 50.0)
        everywhere = list(range(len(self.world.ground.middles_m)))
        self.world.draw(clip_from_above(middle_ned_m, half_m, half_m), above, everywhere, nobody, 0.0)
        picture = _read(target)
        target.release()
        return picture

    def _draw_sky(self, view: CameraView) -> None:
        """Draw the sky, unless all rays of the picture's corners point to the ground."""
        ned_from_ray: Array = view.rotation_ned_from_camera @ np.diag((*half_tangents(self._info), 1.0))
        corners = np.array([(a, b, 1.0) for a in (-1, 1) for b in (-1, 1)])
        if (corners @ ned_from_ray[2]).min() > 0.02:
            return
        put(self._sky_program["ned_from_ray"], ned_from_ray)
        self._gl.depth_func = "<="
        self._sky.render(moderngl.TRIANGLES)
        self._gl.depth_func = "<"

    def _blur_by(self, moved: float, views: tuple[CameraView, CameraView, CameraView], clip_from_ned: Array) -> None:
        """Blur each pixel along the motion of the point that it shows; points of the rover move with the rover."""
        begin, _, end = views
        ned_from_clip = np.array(np.linalg.inv(clip_from_ned))
        begin_from_ned = self._clip_from_camera @ camera_from_ned(begin)
        end_from_ned = self._clip_from_camera @ camera_from_ned(end)
        half_way = np.array((*(0.5 * np.subtract(end.pos_rover_ned_m, begin.pos_rover_ned_m)), 0.0))
        program = self._blur_program
        put(program["begin_from_clip"], begin_from_ned @ ned_from_clip)
        put(program["end_from_clip"], end_from_ned @ ned_from_clip)
        program["w_ned_from_clip"] = tuple(ned_from_clip[3].tolist())
        program["rover_in_begin"] = tuple((begin_from_ned @ half_way).tolist())
        program["rover_in_end"] = tuple((end_from_ned @ half_way).tolist())
        program["taps"] = min(2 + int(moved), TAPS_MAX)
        self._sharp.use(SHARP_UNIT)
        self._depth.use(DEPTH_UNIT)
        self._blurred.use()
        self._gl.disable(moderngl.DEPTH_TEST)
        self._blur.render(moderngl.TRIANGLES)
        self._gl.enable(moderngl.DEPTH_TEST)


def _read(target: moderngl.Framebuffer) -> Image:
    width, height = target.size
    return np.frombuffer(target.read(components=3, alignment=1), dtype=np.uint8).reshape(height, width, 3)


def _shadow_area(view: CameraView) -> tuple[Vec3, float]:
    """Point in the middle of the picture, and the radius around it within which shadows are needed."""
    north_m, east_m, down_m = view.pos_camera_ned_m
    rover_north_m, rover_east_m, rover_down_m = view.pos_rover_ned_m
    beside_m = max(abs(north_m - rover_north_m), abs(east_m - rover_east_m))
    surface_m = rover_down_m if beside_m < ON_PLATFORM_M and down_m < rover_down_m else 0.0
    forward = view.axes_camera_ned[2]
    steepness = max(forward[2], 0.2)
    away_m = min(max(surface_m - down_m, 0.1) / steepness, SIGHT_MAX_M)
    middle_ned_m = (north_m + away_m * forward[0], east_m + away_m * forward[1], surface_m)
    return middle_ned_m, 1.25 * away_m + 0.1 + 8.0 * (1.0 - steepness)
