"""The autopilot's reported state."""

from dataclasses import dataclass, field

import msgspec

from jezero.frames import Vec3
from jezero.schemas.state import Battery, Geodetic, Odometry
from jezero.services.vehicle_bridge.foreign_setpoints import SetpointEcho
from jezero.services.vehicle_bridge.resets import ResetHistory


@dataclass
class Telemetry:
    """State that the autopilot has reported; None and "" until it has.

    Attributes:
        received_wall_ns: wall time of the last message.
        heartbeat_wall_ns: wall time of the last HEARTBEAT, or of the last request for one.
        armed: the motors may run.
        landed: state of the land detector.
        mode: mode by PX4's name.
        failsafe: a failsafe chose the mode.
        armable: the autopilot's arming checks pass.
        origin_deg: origin of the world frame.
        battery: None when the autopilot doesn't measure it.
        battery_critical: see `Battery.critical`.
        odometry: newest odometry.
        resets: steps of the position estimate.
        warning: last STATUSTEXT of severity warning or worse.
        warning_ns: timer's time of `warning`.
    """

    received_wall_ns: int | None = None
    heartbeat_wall_ns: int = 0
    armed: bool | None = None
    landed: bool | None = None
    mode: str = ""
    failsafe: bool = False
    armable: bool = False
    origin_deg: Geodetic | None = None
    battery: Battery | None = None
    battery_critical: float | None = None
    odometry: Odometry | None = None
    resets: ResetHistory = field(default_factory=ResetHistory)
    warning: str = ""
    warning_ns: int = 0


class TelemetryBatch(msgspec.Struct):
    """Contents of one batch of bytes, oldest first.

    Attributes:
        timer_ns: timer's time of arrival.
        wall_ns: wall time of arrival.
        epoch_id: epoch of the vehicle.
        odometry: all valid odometry.
        steps_ned_m: steps of the position estimate at the autopilot's resets.
        setpoint_echo: the newest one.
        restarted: the autopilot's time stepped back.
    """

    timer_ns: int
    wall_ns: int
    epoch_id: int
    odometry: list[Odometry] = msgspec.field(default_factory=list)
    steps_ned_m: list[Vec3] = msgspec.field(default_factory=list)
    setpoint_echo: SetpointEcho | None = None
    restarted: bool = False
