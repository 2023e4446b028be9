"""`jezero ros2`: the vehicle in ROS 2."""

import sys

import click

from jezero.cli.options import vehicle_options

HOW = """there is no rclpy. In this shell, source a ROS 2 environment (`source /opt/ros/jazzy/setup.bash`), and install
jezero's command line in the Python of ROS (`pip install "jezero[cli]"`)"""


@click.group()
def ros2() -> None:
    """Show the vehicle in ROS 2, and command it from there."""


@ros2.command()
@click.option("--clock/--no-clock", default=True, show_default=True,
              help="Publish /clock; for one vehicle only, where there are several.")  # fmt: skip
@click.option("--commands", is_flag=True, help="Fly to each pose that is published on goal_pose.")
@vehicle_options
def bridge(vehicle: str, router: str, clock: bool, commands: bool) -> None:
    """Publish the vehicle's topics in ROS 2, and serve its actions, services and parameters, until Ctrl+C.

    It runs where ROS 2 is, in a sourced environment, and connects to the vehicle's router as any client does. All
    names are in the vehicle's namespace, such as /uav1/odometry and /uav1/takeoff. Actions need the package
    jezero_interfaces of deploy/ros2 in that environment.
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

    config = load_config(VehicleConfig, "vehicle")
    try:
        with Vehicle.connect(vehicle, router=router) as uav:
            run_bridge(uav, vehicle, config, uses_clock=clock, commands=commands)
    except JezeroError as error:
        raise click.ClickException(str(error)) from None
    sys.exit(0)
