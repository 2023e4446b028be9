"""Settings of the vehicle bridge. What spec §3 and architecture §5 fix in figures is a constant where it is used."""

from typing import Annotated

from msgspec import Meta

from jezero.runtime.config import Config

Seconds = Annotated[float, Meta(gt=0.0, le=600.0)]
Metres = Annotated[float, Meta(gt=0.0, le=10_000.0)]
ParameterName = Annotated[str, Meta(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")]
ParameterValue = Annotated[int, Meta(ge=-4_194_304, le=2_139_095_040)] | Annotated[float, Meta(gt=-1e30, lt=1e30)]
"""An integer or a float, as the autopilot has it; further integers wouldn't survive as the bytes of a float."""


class VehicleBridgeConfig(Config, frozen=True, kw_only=True):
    """Limits and patience of the one who commands the autopilot.

    Attributes:
        rate_hz: of its steps while nothing arrives; a target is streamed anew at 20 Hz at most, and at this rate.
        altitude_limit_m, distance_limit_m: of a hover point, above and horizontally from the world's origin.
        range_force_max_m: nothing is disarmed by force while the altimeter measures more, tilt-corrected: 0.1 m under
            the feet, above which it is mounted by as much.
        low_height_m, climb_height_m: an abort below the first climbs to the second, over ground or deck.
        takeoff_speed_max_mps: nothing takes off from something that moves faster over ground, such as a driving rover.
        tilt_limit_rad, tilt_timeout_s: tilted further than this for so long, the motors are cut.
        setpoint_timeout_s: without a setpoint from the goal in charge for so long, the bridge hovers.
        engage_timeout_s: for offboard mode and arming together.
        disarm_timeout_s: for a normal disarm on the ground.
        link_timeout_s: of telemetry missing, after which a goal ends and a hover begins.
        blind_timeout_s: of telemetry missing, after which the bridge stops streaming and the autopilot lands.
        router_timeout_s: without the bus's router, after which the bridge commands a landing.
        parameters: of the autopilot, set whenever it is first heard; 1 is an integer, 1.0 a float.
    """

    rate_hz: Annotated[float, Meta(ge=20.0, le=250.0)] = 50.0
    altitude_limit_m: Metres = 120.0
    distance_limit_m: Metres = 500.0
    range_force_max_m: Metres = 0.2
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
