"""`python -m jezero.services.camera`: the driver of a real camera as a process."""

import sys
from collections.abc import Mapping

from jezero.base.config import ConfigError, load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.runtime.video import SOURCES, VideoLink, shown_source, source_of
from jezero.services.camera.config import CameraDriverConfig
from jezero.services.camera.service import LINK, CameraDriver

SETTING = "source in camera_driver.toml"


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The driver of the configured camera, and the link to it."""
    config, vehicle = load_config(CameraDriverConfig, "camera_driver"), load_config(VehicleConfig, "vehicle")
    if not config.source:
        raise ConfigError(f"there is no {SETTING}: write {SOURCES}")
    mount = vehicle.camera
    size_px = (mount.width_px, mount.height_px)
    open_source = source_of(SETTING, config.source, size_px, mount.rate_hz, config.pixel_format)
    return CameraDriver(config, vehicle, shown_source(config.source)), {LINK: VideoLink(open_source, mount.rate_hz)}


if __name__ == "__main__":
    sys.exit(run_process("camera_driver", build))
