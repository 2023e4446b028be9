"""Runs `jezero ros2 bridge`, and RViz with `rviz:=true`: `ros2 launch jezero_bringup bridge.launch.py vehicle:=uav1`.

The command `jezero` must be on the PATH: activate the environment in which it is installed.
"""

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
ROVER_ARGUMENTS = {
    "rover_odometry": "Topic of a ROS rover's nav_msgs/Odometry.",
    "rover_cmd_vel": "Topic on which the ROS rover is driven.",
    "rover_driver": "HOST:PORT of jezero's rover_driver.",
    "rover_heading": "Heading of the odometry's x axis, in degrees clockwise from north.",
}


def bridge(context):
    """The command of the bridge, with the words that the arguments stand for."""
    names = ("vehicle", "router", "commands", "clock", *ROVER_ARGUMENTS)
    value = {name: LaunchConfiguration(name).perform(context) for name in names}
    words = ["jezero", "ros2", "bridge", "--vehicle", value["vehicle"], "--router", value["router"]]
    if value["commands"] == "true":
        words.append("--commands")
    if value["clock"] == "false":
        words.append("--no-clock")
    for name in ROVER_ARGUMENTS:
        if value[name]:
            words += [f"--{name.replace('_', '-')}", value[name]]
    return [ExecuteProcess(cmd=words, output="screen", sigterm_timeout="10")]


def rviz(context):
    """RViz with the layout, in which the vehicle's name takes the place of `uav1`."""
    vehicle = re.sub(r"\W", "_", LaunchConfiguration("vehicle").perform(context))
    layout = Path(tempfile.mkdtemp(prefix="jezero-")) / LAYOUT.name
    layout.write_text(LAYOUT.read_text().replace(LAYOUTS_VEHICLE, vehicle))
    words = ["rviz2", "-d", str(layout), "--ros-args", "-p", "use_sim_time:=true"]
    return [ExecuteProcess(cmd=words, output="screen")]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("vehicle", default_value="uav1", description="The vehicle's name."),
            DeclareLaunchArgument("router", default_value="tcp/127.0.0.1:7447", description="Endpoint of its router."),
            DeclareLaunchArgument("commands", default_value="false", description="Fly by goal_pose and cmd_vel."),
            DeclareLaunchArgument("clock", default_value="true", description="Publish /clock."),
            *(
                DeclareLaunchArgument(name, default_value="", description=about)
                for name, about in ROVER_ARGUMENTS.items()
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="Open RViz."),
            OpaqueFunction(function=bridge),
            OpaqueFunction(function=rviz, condition=IfCondition(LaunchConfiguration("rviz"))),
        ]
    )
