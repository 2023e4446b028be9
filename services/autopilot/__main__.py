"""`python -m jezero.services.autopilot`: the embedded autopilot as a process, on PX4's ports, or PX4 itself."""

import os
import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from jezero.base.config import ConfigError, chosen_autopilot, load_config
from jezero.base.mavlink import UNIX_2015_S
from jezero.base.vehicle_config import BatteryConfig, VehicleConfig, px4_refusal
from jezero.keys.controller_key import controller_key
from jezero.runtime.instance import Instance
from jezero.runtime.links import SocketLink, TcpClient, Udp
from jezero.runtime.process import run_process
from jezero.runtime.service import Service
from jezero.services.autopilot import px4
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.ground_link import (
    HOST_VARIABLE,
    LOOPBACK,
    ground_host,
    insecurity,
    is_local,
    kept_stamp_path,
    load_stamp,
    save_stamp,
    with_signatures,
)
from jezero.services.autopilot.px4_link import ChildLink
from jezero.services.autopilot.service import GCS, HIL, OFFBOARD, Autopilot

ANY = "0.0.0.0"


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The autopilot of an instance, and its links."""
    config, vehicle = load_config(AutopilotConfig, "autopilot"), load_config(VehicleConfig, "vehicle")
    ground = ground_host()
    if chosen_autopilot() == "px4":
        if refusal := px4_refusal(vehicle):
            raise ConfigError(refusal)
        if not is_local(ground):
            raise ConfigError(f"{HOST_VARIABLE} is for the embedded autopilot: PX4 has settings of its own for MAVLink")
        return px4.Px4(), {px4.PX4: _px4_link(instance, vehicle.battery)}
    config = with_signatures(config, ground)
    since_2015_s, path = time.time() - UNIX_2015_S, kept_stamp_path()
    kept_stamp, keep_stamp = load_stamp(path, int(since_2015_s * 1e5)), partial(save_stamp, path)
    warning = insecurity(config.signing, ground)
    key = controller_key()
    return Autopilot(config, vehicle, instance.system_id, since_2015_s, warning, kept_stamp, keep_stamp, key), {
        HIL: TcpClient(LOOPBACK, instance.hil_port),
        OFFBOARD: Udp((LOOPBACK, instance.autopilot_offboard_port), (LOOPBACK, instance.bridge_port)),
        GCS: Udp((LOOPBACK if is_local(ground) else ANY, instance.autopilot_gcs_port), (ground, instance.gcs_port)),
    }


def _px4_link(instance: Instance, battery: BatteryConfig) -> ChildLink:
    runtime, run_dir = os.environ.get("JEZERO_PX4_DIR"), os.environ.get("JEZERO_RUN_DIR")
    return ChildLink(
        "PX4",
        px4.command(Path(runtime) if runtime else None, instance.number),
        px4.environment(battery),
        Path(run_dir).absolute() / "px4" if run_dir else None,
        instance.hil_port,
    )


if __name__ == "__main__":
    sys.exit(run_process("autopilot", build))
