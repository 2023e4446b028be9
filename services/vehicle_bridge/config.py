"""Settings of the vehicle bridge. Figures that nobody should change are constants where they are used."""

from typing import Annotated, Literal

from msgspec import Meta

from jezero.base.config import Config
from jezero.schemas.struct import END

ParameterName = Annotated[str, Meta(pattern=rf"^[A-Z][A-Z0-9_]{{0,15}}{END}")]
ParameterValue = Annotated[int, Meta(ge=-4_194_304, le=2_139_095_040)] | Annotated[float, Meta(gt=-1e30, lt=1e30)]
"""Integer or float, as the autopilot has it; other integers wouldn't survive as the bytes of a float."""
OnFence = Literal["stop", "return", "land"]


class VehicleBridgeConfig(Config, frozen=True, kw_only=True):
    """Rate, a limit, a time-out, and the autopilot's parameters.

    Attributes:
        link: the flight controller of a real vehicle, which is then the master of vehicle time:
            `serial:/dev/ttyACM0:921600`, `udpin:ADDRESS:PORT` (the controller sends there), `udpout:HOST:PORT` (it
            listens there) or `tcp:HOST:PORT`; "" for the autopilot of the simulation.
        system_id: MAVLink system id of the vehicle; 0 for 1 plus the number of the stack.
        rate_hz: steps per second while no trigger arrives; the present target is sent again at this rate, but at most
            at 20 Hz.
        takeoff_speed_max_mps: maximum ground speed at which a takeoff is accepted, for a vehicle on a driving rover.
        router_timeout_s: time without the bus's router after which the bridge commands a landing.
        fence: file of the fence that is in force when the bridge starts, as `jezero fence check` reads it; "" for none.
        on_fence: what a vehicle does that was pushed out of the fence: it stops and hovers there; stops and then
            returns inside; or lands. A goal that was flying ends.
        parameters: parameters that are set when the simulated autopilot first connects; 1 is an integer, 1.0 a
            float. A real flight controller gets none of them.
    """

    link: str = ""
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    rate_hz: Annotated[float, Meta(ge=20.0, le=250.0)] = 50.0
    takeoff_speed_max_mps: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.3
    router_timeout_s: Annotated[float, Meta(gt=0.0, le=600.0)] = 30.0
    fence: str = ""
    on_fence: OnFence = "return"
    parameters: dict[ParameterName, ParameterValue] = {}
