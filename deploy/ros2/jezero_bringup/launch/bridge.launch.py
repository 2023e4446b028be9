"""Starts `jezero ros2 bridge`, and RViz with `rviz:=true`: `ros2 launch jezero_bringup bridge.launch.py vehicle:=uav1`.

The command `jezero` must be on the PATH: activate the environment in which it is installed.
"""

import os
import re
import tempfile
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

LAYOUT = Path(__file__).parents[1] / "rviz" / "vehicle.rviz"
LAYOUTS_VEHICLE = "uav1"
"""Vehicle whose topics and frames the layout has."""
OPTIONS = {
    "vehicle": (os.environ.get("JEZERO_VEHICLE", "uav1"), "The vehicle's name."),
    "router": (os.environ.get("JEZERO_ROUTER", "tcp/127.0.0.1:7447"), "Endpoint of its router."),
    "keys": (os.environ.get("JEZERO_KEYS", ""), "Folder of the bundle of `jezero keys`, for an address with tls."),
    "rover_odometry": ("", "Topic of a ROS rover's nav_msgs/Odometry."),
    "rover_cmd_vel": ("", "Topic on which the ROS rover is driven."),
    "rover_driver": ("127.0.0.1:9001", "HOST:PORT of jezero's rover_driver."),
    "rover_heading": ("90.0", "Heading of the odometry's x axis, in degrees clockwise from north."),
}
FLAGS = {
    "commands": ("false", "Fly by goal_pose and cmd_vel."),
    "clock": ("true", "Publish /clock."),
    "insecure": ("false", "Connect to another computer without TLS, on a network that you trust."),
}
"""Defaults and descriptions of the bridge's options; `rover_odometry` is `--rover-odometry`."""


def bridge(context):
    """The command of the bridge, with the words that the arguments stand for."""
    words = ["jezero", "ros2", "bridge"]
    for name in OPTIONS:
        if value := LaunchConfiguration(name).perform(context):
            words += [f"--{name.replace('_', '-')}", value]
    for name, (default, _) in FLAGS.items():
        value = LaunchConfiguration(name).perform(context)
        if value != default:
            words.append(f"--{name}" if value == "true" else f"--no-{name}")
    return [ExecuteProcess(cmd=words, output="screen", sigterm_timeout="10")]


def rviz(context):
    """RViz with the layout, in which the vehicle's namespace takes the place of `uav1`."""
    namespace = re.sub(r"\W", "_", LaunchConfiguration("vehicle").perform(context), flags=re.ASCII)
    if namespace[:1].isdigit():
        namespace = f"_{namespace}"
    layout = Path(tempfile.mkdtemp(prefix="jezero-")) / LAYOUT.name
    layout.write_text(LAYOUT.read_text().replace(LAYOUTS_VEHICLE, namespace))
    words = ["rviz2", "-d", str(layout), "--ros-args", "-p", "use_sim_time:=true"]
    return [ExecuteProcess(cmd=words, output="screen")]


def generate_launch_description():
    flags = FLAGS | {"rviz": ("false", "Open RViz.")}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=about)
                for name, (value, about) in OPTIONS.items()
            ),
            *(
                DeclareLaunchArgument(name, default_value=value, description=about, choices=["true", "false"])
                for name, (value, about) in flags.items()
            ),
            OpaqueFunction(function=bridge),
            OpaqueFunction(function=rviz, condition=IfCondition(LaunchConfiguration("rviz"))),
        ]
    )
