"""Delay of odometry from a client of jezero to a subscriber in ROS 2, and the processor time of the bridge.

`python -m benchmarks.speed.ros2 --python PYTHON [--seconds 20]`; PYTHON is an interpreter with rclpy and jezero.
Without images, and while somebody subscribes to them. Prints p50 and p99 of the time from the arrival of a message at a
client of jezero until its arrival at a subscriber in ROS on the same computer.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

from benchmarks.speed.stack import cpu_ns, percentile, running_stack
from jezero import Vehicle
from jezero.runtime.instance import Instance
from jezero.schemas.state import Odometry
from jezero.schemas.topics import ODOMETRY

INSTANCE = Instance(vehicle="rosbench", router="tcp/127.0.0.1:7498", number=9, gcs_port=14609)
DOMAIN = {"ROS_DOMAIN_ID": "88", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
SETTLES_S = 5.0
LISTENER = """
import sys, time
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

rclpy.init()
node = Node("listener")
quality = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
images = [0]


def on_odometry(message):
    stamp = message.header.stamp
    print(stamp.sec * 1_000_000_000 + stamp.nanosec, time.monotonic_ns(), flush=True)


def on_image(message):
    images[0] += 1


node.create_subscription(Odometry, "/rosbench/odometry", on_odometry, quality)
if sys.argv[2] == "images":
    node.create_subscription(Image, "/rosbench/camera/image_raw", on_image, quality)
end_s = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end_s:
    rclpy.spin_once(node, timeout_sec=0.1)
print("images", images[0], flush=True)
"""


def measure(uav: Vehicle, python: str, environment: dict[str, str], seconds: float, words: str) -> dict[str, object]:
    """Listen for some seconds, with the bridge running."""
    arrived_ns: dict[int, int] = {}

    def on_odometry(message: Odometry) -> None:
        arrived_ns[message.t_ns] = time.monotonic_ns()

    subscription = uav.subscribe(ODOMETRY, on_odometry)
    bridge = subprocess.Popen([python, "-m", "jezero.cli.main", "ros2", "bridge"], env=environment)
    try:
        time.sleep(SETTLES_S)
        listener = subprocess.Popen(
            [python, "-c", LISTENER, str(seconds), words], env=environment, stdout=subprocess.PIPE, text=True
        )
        time.sleep(SETTLES_S)
        before_ns, begin_s = cpu_ns(bridge.pid), time.monotonic()
        lines = listener.communicate(timeout=seconds + 60.0)[0].splitlines()
        share = (cpu_ns(bridge.pid) - before_ns) * 1e-9 / (time.monotonic() - begin_s)
    finally:
        bridge.terminate()
        bridge.wait(timeout=30.0)
        subscription.close()
    pairs = [tuple(map(int, line.split())) for line in lines if line[0].isdigit()]
    delays_ms = [(ros_ns - arrived_ns[t_ns]) * 1e-6 for t_ns, ros_ns in pairs if t_ns in arrived_ns]
    return {
        "subscribed": words,
        "messages": len(delays_ms),
        "p50_ms": round(percentile(delays_ms, 0.5), 2),
        "p99_ms": round(percentile(delays_ms, 0.99), 2),
        "images_per_s": round(int(lines[-1].split()[1]) / seconds, 1),
        "bridge_core_share": round(share, 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--python", required=True)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, running_stack(INSTANCE, Path(scratch) / "run"):
        environment = {
            **os.environ,
            **DOMAIN,
            "JEZERO_VEHICLE": INSTANCE.vehicle,
            "JEZERO_ROUTER": INSTANCE.router,
        }
        with Vehicle.connect(INSTANCE.vehicle, router=INSTANCE.router) as uav:
            for words in ("odometry", "images"):
                print(json.dumps(measure(uav, options.python, environment, options.seconds, words)), flush=True)


if __name__ == "__main__":
    main()
