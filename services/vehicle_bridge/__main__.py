"""`python -m jezero.services.vehicle_bridge`: the bridge over Zenoh, MAVLink on UDP 14540 + instance."""

import sys

from jezero.runtime.config import ConfigError, instance_from_environment, load_config
from jezero.runtime.links import Udp
from jezero.runtime.zenoh_bus import new_boot_id, run_service
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import LINK, VehicleBridge

HOST = "127.0.0.1"


def main() -> int:
    try:
        instance = instance_from_environment()
        config = load_config(VehicleBridgeConfig, "vehicle_bridge")
    except ConfigError as error:
        print(f"vehicle_bridge: {error}", file=sys.stderr)
        return 1
    boot_id = new_boot_id()
    bridge = VehicleBridge(config, instance.system_id, boot_id)
    return run_service(bridge, instance, boot_id, {LINK: Udp((HOST, instance.bridge_port))})


if __name__ == "__main__":
    sys.exit(main())
