"""The camera with the renderer of its settings."""

import dataclasses

import msgspec

from jezero.base.frames import scale as times
from jezero.base.vehicle_config import VehicleConfig
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.detections import NO_OBSTACLES
from jezero.services.simulator.camera.service import SPEC, CameraSimulator, NoEglError, Renderer
from jezero.services.simulator.config import SimulatorConfig, TerrainConfig
from jezero.services.simulator.noise import generator
from jezero.services.simulator.obstacles import obstacle_triangles


def make_camera(config: CameraConfig, simulator: SimulatorConfig, vehicle: VehicleConfig, seed: int) -> CameraSimulator:
    """A camera in the world that the simulator's settings describe.

    Raises:
        NoEglError: `renderer` is "egl", and there is none.
        ConfigError: the file of heights or of a model can't be used.
    """
    made_with = {"config": config, "simulator": simulator, "vehicle": vehicle, "seed": seed}
    vehicle = _with_printed_board(vehicle, config.print_scale)
    renderer = make_renderer(config, simulator.terrain, vehicle, seed) if config.mode == "rendered" else None
    if renderer is not None and renderer.rate_max_hz < vehicle.camera.rate_hz:
        slower = msgspec.structs.replace(vehicle.camera, rate_hz=renderer.rate_max_hz)
        vehicle = msgspec.structs.replace(vehicle, camera=slower)
    obstacles_ned_m = obstacle_triangles(simulator.terrain) if renderer is None else NO_OBSTACLES
    camera = CameraSimulator(config, vehicle, renderer, seed, obstacles_ned_m)
    camera.spec = dataclasses.replace(SPEC, made_with=made_with)
    return camera


def _with_printed_board(vehicle: VehicleConfig, scale: float) -> VehicleConfig:
    """The robot with a landing board of another size than configured.

    Raises:
        ValueError: the platform is too small for this board.
    """
    if scale == 1.0:
        return vehicle
    replace = msgspec.structs.replace
    board = tuple(
        replace(tag, side_m=scale * tag.side_m, pos_rover_body_m=times(tag.pos_rover_body_m, scale))
        for tag in vehicle.platform.board
    )
    return replace(vehicle, platform=replace(vehicle.platform, tags=board))


def make_renderer(config: CameraConfig, terrain: TerrainConfig, vehicle: VehicleConfig, seed: int) -> Renderer:
    """The renderer of the settings, through the lens of the vehicle's camera.

    Raises:
        NoEglError: `renderer` is "egl", and there is none.
    """
    if vehicle.camera.is_plain:
        return _make_pinhole(config, terrain, vehicle, seed)
    from jezero.services.simulator.camera.through_lens import LensRenderer, pinhole_behind

    wide = msgspec.structs.replace(vehicle, camera=pinhole_behind(vehicle.camera))
    return LensRenderer(_make_pinhole(config, terrain, wide, seed), vehicle.camera, wide.camera)


def _make_pinhole(config: CameraConfig, terrain: TerrainConfig, vehicle: VehicleConfig, seed: int) -> Renderer:
    """The renderer of the settings; the libraries of each renderer are imported only when it is used.

    Raises:
        NoEglError: `renderer` is "egl", and there is none.
    """
    from jezero.services.simulator.camera.egl_renderer import EglRenderer
    from jezero.services.simulator.camera.exposure import PixelNoise

    noise = PixelNoise(config.std_pixel, generator(seed, "pixels"))
    if config.renderer != "tiny":
        try:
            return EglRenderer(terrain, vehicle, noise)
        except NoEglError:
            if config.renderer == "egl":
                raise
    from jezero.services.simulator.camera.tiny_renderer import TinyRenderer

    return TinyRenderer(terrain, vehicle, noise)
