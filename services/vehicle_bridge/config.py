"""Settings of the vehicle bridge. Figures that spec §3 and architecture §5 fix are constants where they are used."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Seconds = Annotated[float, Meta(gt=0.0, le=600.0)]
Metres = Annotated[float, Meta(gt=0.0, le=10_000.0)]
ParameterName = Annotated[str, Meta(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")]
ParameterValue = Annotated[int, Meta(ge=-4_194_304, le=2_139_095_040)] | Annotated[float, Meta(gt=-1e30, lt=1e30)]
"""Integer or float, as the autopilot has it; other integers wouldn't survive as the bytes of a float."""


class VehicleBridgeConfig(Config, frozen=True, kw_only=True):
    """Heights, time-outs and parameters of the bridge.

    Attributes:
        rate_hz: steps per second while nothing arrives; a target is streamed again at this rate, at most at 20 Hz.
        low_height_m: an abort below this height over ground or platform climbs first.
        climb_height_m: height to which such an abort climbs.
        takeoff_speed_max_mps: ground speed limit for a takeoff, as from a driving rover.
        tilt_limit_rad: tilt limit in flight.
        tilt_timeout_s: tilted further than the limit for this time, the motors are cut.
        setpoint_timeout_s: without a setpoint from the goal in charge for this time, the bridge hovers.
        engage_timeout_s: time-out of offboard mode and arming together.
        disarm_timeout_s: time-out of a normal disarm on the ground.
        link_timeout_s: without telemetry for this time, a goal ends and a hover begins.
        blind_timeout_s: without telemetry for this time, the bridge stops streaming and the autopilot lands.
        router_timeout_s: without the bus's router for this time, the bridge commands a landing.
        parameters: parameters that are set when the autopilot first connects; 1 is an integer, 1.0 a float.
    """

    rate_hz: Annotated[float, Meta(ge=20.0, le=250.0)] = 50.0
    low_height_m: Metres = 1.0
    climb_height_m: Metres = 1.5
    takeoff_speed_max_mps: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.3
    tilt_limit_rad: Annotated[float, Meta(gt=0.0, le=3.1416)] = 1.0472
    tilt_timeout_s: Seconds = 0.5
    setpoint_timeout_s: Annotated[float, Meta(ge=0.1, le=0.45)] = 0.3
    engage_timeout_s: Seconds = 5.0
    disarm_timeout_s: Seconds = 10.0
    link_timeout_s: Seconds = 1.0
    blind_timeout_s: Seconds = 5.0
    router_timeout_s: Seconds = 30.0
    parameters: dict[ParameterName, ParameterValue] = {}
