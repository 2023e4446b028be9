"""`python -m jezero.services.autopilot`: the embedded autopilot as a process, on PX4's ports."""

import sys
from collections.abc import Mapping

from jezero.runtime.config import Instance, load_config
from jezero.runtime.links import SocketLink, TcpClient, Udp
from jezero.runtime.service import Service
from jezero.runtime.zenoh_bus import run_process
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.service import GCS, HIL, OFFBOARD, Autopilot

HOST = "127.0.0.1"
GCS_PORT = 14550


def build(instance: Instance, boot_id: int) -> tuple[Service, Mapping[str, SocketLink]]:
    """The autopilot of an instance, and its links."""
    autopilot = Autopilot(load_config(AutopilotConfig, "autopilot"), instance.system_id, boot_id)
    return autopilot, {
        HIL: TcpClient(HOST, instance.hil_port),
        OFFBOARD: Udp((HOST, instance.autopilot_offboard_port), (HOST, instance.bridge_port)),
        GCS: Udp((HOST, instance.autopilot_gcs_port), (HOST, GCS_PORT)),
    }


if __name__ == "__main__":
    sys.exit(run_process("autopilot", build))
