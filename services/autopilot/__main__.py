"""`python -m jezero.services.autopilot`: the embedded autopilot as a process, on PX4's ports."""

import sys

from jezero.runtime.config import ConfigError, instance_from_environment, load_config
from jezero.runtime.links import SocketLink, TcpClient, Udp
from jezero.runtime.zenoh_bus import new_boot_id, run_service
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.service import GCS, HIL, OFFBOARD, Autopilot

HOST = "127.0.0.1"
GCS_PORT = 14550


def main() -> int:
    try:
        instance = instance_from_environment()
        config = load_config(AutopilotConfig, "autopilot")
    except ConfigError as error:
        print(f"autopilot: {error}", file=sys.stderr)
        return 2
    boot_id = new_boot_id()
    links: dict[str, SocketLink] = {
        HIL: TcpClient(HOST, instance.hil_port),
        OFFBOARD: Udp((HOST, instance.autopilot_offboard_port), (HOST, instance.bridge_port)),
        GCS: Udp((HOST, instance.autopilot_gcs_port), (HOST, GCS_PORT)),
    }
    return run_service(Autopilot(config, instance.system_id, boot_id), instance, boot_id, links)


if __name__ == "__main__":
    sys.exit(main())
