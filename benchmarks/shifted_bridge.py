"""`python -m benchmarks.shifted_bridge PORT`: the vehicle bridge, listening to MAVLink on another port than usual."""

import sys

from jezero.runtime.links import Udp
from jezero.runtime.zenoh_bus import run_process
from jezero.services.vehicle_bridge.__main__ import HOST, build
from jezero.services.vehicle_bridge.service import LINK

if __name__ == "__main__":
    port = int(sys.argv[1])
    sys.exit(
        run_process("vehicle_bridge", lambda instance, boot: (build(instance, boot)[0], {LINK: Udp((HOST, port))}))
    )
