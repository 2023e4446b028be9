"""`jezero ros2`: the vehicle in ROS 2."""

import sys
from math import radians
from typing import Any

import click

from jezero.cli.options import FINITE, CommandGroup, vehicle_options

HOW = """there is no rclpy. In this shell, source a ROS 2 environment (`source /opt/ros/jazzy/setup.bash`), and install
jezero's command line in the Python of ROS (`pip install "jezero[cli]"`)"""


class HostPort(click.ParamType[tuple[str, int]]):
    """A host and a port."""

    name = "host:port"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, int]:
        if isinstance(value, tuple):
            return value
        host, _, port = str(value).rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            self.fail(f"{value!r} is not HOST:PORT, such as 127.0.0.1:9001", param, ctx)
        return host, int(port)


@click.group(cls=CommandGroup)
def ros2() -> None:
    """Show the vehicle in ROS 2, and command it from there."""


@ros2.command()
@click.option("--clock/--no-clock", default=True, show_default=True,
              help="Publish /clock; for one vehicle only, where there are several.")  # fmt: skip
@click.option(
    "--commands",
    is_flag=True,
    help="Fly to each pose that is published on goal_pose, and by the velocities on cmd_vel.",
)
@click.option(
    "--rover-odometry",
    metavar="TOPIC",
    default="",
    help="The rover's nav_msgs/Odometry, which goes to the service rover_driver.",
)
@click.option(
    "--rover-cmd-vel",
    metavar="TOPIC",
    default="",
    help="Publish jezero's drive commands there, as geometry_msgs/Twist.",
)
@click.option(
    "--rover-driver",
    type=HostPort(),
    default="127.0.0.1:9001",
    show_default=True,
    help='Where rover_driver listens: link = "udpin:HOST:PORT" in rover_driver.toml, with format = "json".',
)
@click.option("--rover-heading", type=FINITE, default=90.0, show_default=True, metavar="DEG",
              help="Heading of the x axis of the odometry's frame, clockwise from north; 90 is east.")  # fmt: skip
@vehicle_options
def bridge(
    vehicle: str,
    router: str,
    clock: bool,
    commands: bool,
    rover_odometry: str,
    rover_cmd_vel: str,
    rover_driver: tuple[str, int],
    rover_heading: float,
) -> None:
    """Publish the vehicle's topics in ROS 2, and serve its actions, services and parameters, until Ctrl+C.

    It runs where ROS 2 is, in a sourced environment, and connects to the vehicle's router as any client does. All
    names are in the vehicle's namespace, such as /uav1/odometry and /uav1/takeoff. Actions need the package
    jezero_interfaces of deploy/ros2 in that environment.

    With --rover-odometry a rover of ROS is the rover on which the vehicle lands.
    """
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        why = HOW if error.name == "rclpy" else f"rclpy can't be imported: {error}"
        raise click.ClickException(why) from None
    from jezero.base.config import load_config
    from jezero.base.vehicle_config import VehicleConfig
    from jezero.client.errors import JezeroError
    from jezero.client.vehicle import Vehicle
    from jezero.services.ros2_bridge.node import run_bridge
    from jezero.services.ros2_bridge.rover_node import RoverTopics

    config = load_config(VehicleConfig, "vehicle")
    rover = None
    if rover_odometry or rover_cmd_vel:
        rover = RoverTopics(rover_odometry, rover_cmd_vel, rover_driver, radians(rover_heading))
    try:
        with Vehicle.connect(vehicle, router=router) as uav:
            run_bridge(uav, vehicle, config, uses_clock=clock, commands=commands, rover=rover)
    except JezeroError as error:
        raise click.ClickException(str(error)) from None
    sys.exit(0)
