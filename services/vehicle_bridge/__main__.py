"""`python -m jezero.services.vehicle_bridge`: the bridge over Zenoh.

Its MAVLink is on UDP 14540 + instance, or on the link to a real flight controller.
"""

import sys
import time
from collections.abc import Mapping
from functools import partial
from secrets import token_hex

from jezero.base.config import load_config
from jezero.base.mavlink import UNIX_2015_S
from jezero.base.plugins import action_names
from jezero.base.vehicle_config import VehicleConfig
from jezero.keys.controller_key import REMEDY, controller_key
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink, Udp, link_of
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.schemas.fence import Fence
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.kept_fence import kept_fence_path, load, save
from jezero.services.vehicle_bridge.service import LINK, VehicleBridge
from jezero.services.vehicle_bridge.time_sync import kept_epoch_path, load_epoch, save_epoch

HOST = "127.0.0.1"


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The bridge of an instance, and its link to the autopilot."""
    config, vehicle = load_config(VehicleBridgeConfig, "vehicle_bridge"), load_config(VehicleConfig, "vehicle")
    key = controller_key()
    path = kept_fence_path()
    kept = None if path is None else load(path)
    fence = _fence_of(config.fence) if kept is None else kept.fence
    keep = _keep_nothing if path is None else partial(save, path)
    epoch_path = kept_epoch_path()
    bridge = VehicleBridge(
        config,
        vehicle,
        config.system_id or instance.system_id,
        boot_id,
        secret=token_hex(8),
        actions=action_names(),
        fence=fence,
        keep_fence=keep,
        name=instance.vehicle,
        kept_epoch=None if epoch_path is None or not config.link else load_epoch(epoch_path),
        keep_epoch=_keep_nothing if epoch_path is None else partial(save_epoch, epoch_path),
        key=key,
        since_2015_s=time.time() - UNIX_2015_S,
    )
    if config.link:
        return bridge, {LINK: link_of("link in vehicle_bridge.toml", config.link, signed=bool(key), remedy=REMEDY)}
    autopilot = (HOST, instance.autopilot_offboard_port)
    return bridge, {LINK: Udp((HOST, instance.bridge_port), autopilot, only_from_peer=True)}


def _fence_of(file: str) -> Fence | None:
    """The fence in the file that the settings name; None where they name none."""
    if not file:
        return None
    from jezero.mission_files import configured_fence  # with planners, which no vehicle without a fence file needs

    return configured_fence(file)


def _keep_nothing(value: object) -> None:
    """There is no run folder: fence and epoch end with the bridge."""


if __name__ == "__main__":
    sys.exit(run_process("vehicle_bridge", build))
