"""The vehicle bridge with another MAVLink port than usual.

`python -m benchmarks.speed.shifted_bridge PORT PEER`: the bridge receives on PORT from PEER, and sends there.
"""

import sys

from jezero.runtime.links import Udp
from jezero.runtime.process import run_process
from jezero.services.vehicle_bridge.__main__ import HOST, build
from jezero.services.vehicle_bridge.service import LINK

if __name__ == "__main__":
    port, peer = int(sys.argv[1]), int(sys.argv[2])
    link = Udp((HOST, port), (HOST, peer), only_from_peer=True)
    sys.exit(run_process("vehicle_bridge", lambda instance, boot: (build(instance, boot)[0], {LINK: link})))
