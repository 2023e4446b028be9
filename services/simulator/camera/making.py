"""The camera with the renderer of its settings."""

import msgspec

from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.service import Camera, NoEglError, Renderer
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.noise import generator
from jezero.vehicle_config import VehicleConfig


def make_camera(config: CameraConfig, simulator: SimulatorConfig, vehicle: VehicleConfig, seed: int) -> Camera:
    """A camera in the world that the simulator's settings describe.

    Raises:
        NoEglError: `renderer` is "egl", and there is none.
    """
    renderer = make_renderer(config, simulator, vehicle, seed) if config.mode == "rendered" else None
    if renderer is not None and renderer.rate_max_hz < vehicle.camera.rate_hz:
        slower = msgspec.structs.replace(vehicle.camera, rate_hz=renderer.rate_max_hz)
        vehicle = msgspec.structs.replace(vehicle, camera=slower)
    return Camera(config, vehicle, renderer, seed)


def make_renderer(config: CameraConfig, simulator: SimulatorConfig, vehicle: VehicleConfig, seed: int) -> Renderer:
    """The renderer of the settings, through the lens of the vehicle's camera.

    Raises:
        NoEglError: `renderer` is "egl", and there is none.
    """
    if not any(vehicle.camera.distortion):
        return _make_pinhole(config, simulator, vehicle, seed)
    from jezero.services.simulator.camera.through_lens import LensRenderer, pinhole_behind

    wide = msgspec.structs.replace(vehicle, camera=pinhole_behind(vehicle.camera))
    return LensRenderer(_make_pinhole(config, simulator, wide, seed), vehicle.camera, wide.camera)


def _make_pinhole(config: CameraConfig, simulator: SimulatorConfig, vehicle: VehicleConfig, seed: int) -> Renderer:
    """The renderer of the settings; the libraries of each renderer are imported only when it is used.

    Raises:
        NoEglError: `renderer` is "egl", and there is none.
    """
    from jezero.services.simulator.camera.egl_renderer import EglRenderer
    from jezero.services.simulator.camera.exposure import PixelNoise

    noise = PixelNoise(config.std_pixel, generator(seed, "pixels"))
    if config.renderer != "tiny":
        try:
            return EglRenderer(simulator, vehicle, noise)
        except NoEglError:
            if config.renderer == "egl":
                raise
    from jezero.services.simulator.camera.tiny_renderer import TinyRenderer

    return TinyRenderer(simulator, vehicle, noise)
