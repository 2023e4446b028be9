"""A flight with MAVSDK as in its documentation, in a process of its own: `mavsdk_client.py PORT`.

Prints one JSON line for each step of the flight.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry


def report(step: str, **values: Any) -> None:
    print(json.dumps({"step": step, **values}), flush=True)


def wait(condition: Callable[[], bool], timeout_s: float, description: str) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"{description}: not within {timeout_s} s")
        time.sleep(0.05)


def main(port: int) -> None:
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk.first_autopilot(20.0)
    if system is None:
        raise SystemExit("no message of an autopilot")
    telemetry, action, offboard, param = Telemetry(system), Action(system), Offboard(system), Param(system)
    report("connected", system_id=system.get_system_id())
    wait(lambda: telemetry.health().is_armable, 30.0, "armable")
    wait(telemetry.health_all_ok, 30.0, "healthy")
    position, battery = telemetry.position(), telemetry.battery()
    report("telemetry", latitude_deg=position.latitude_deg, satellites=telemetry.gps_info().num_satellites,
        voltage_v=battery.voltage_v, remaining_percent=battery.remaining_percent)  # fmt: skip
    param.set_param_float("MIS_TAKEOFF_ALT", 3.0)
    param.set_param_int("COM_DL_LOSS_T", 7)
    parameters = param.get_all_params()
    report("parameters", altitude_m=action.get_takeoff_altitude(), loss_s=param.get_param_int("COM_DL_LOSS_T"),
        count=len(parameters.int_params) + len(parameters.float_params))  # fmt: skip
    action.arm()
    action.takeoff()
    wait(lambda: telemetry.position().relative_altitude_m > 2.5, 30.0, "three metres up")
    report("up", altitude_m=telemetry.position().relative_altitude_m, in_air=telemetry.in_air())
    wait(lambda: telemetry.flight_mode().name == "HOLD", 10.0, "hold after takeoff")
    offboard.set_velocity_ned(VelocityNedYaw(1.0, 0.0, 0.0, 0.0))
    offboard.start()
    before_m = telemetry.position_velocity_ned().position.north_m
    time.sleep(5.0)
    moved = telemetry.position_velocity_ned()
    report("offboard", mode=telemetry.flight_mode().name, moved_m=moved.position.north_m - before_m,
        speed_mps=moved.velocity.north_m_s)  # fmt: skip
    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    offboard.stop()
    action.land()
    wait(lambda: not telemetry.in_air(), 60.0, "landed")
    wait(lambda: not telemetry.armed(), 20.0, "disarmed")
    report("landed")


if __name__ == "__main__":
    main(int(sys.argv[1]))
