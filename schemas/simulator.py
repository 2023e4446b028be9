"""Requests that change the simulated world while it runs, and its state. A real vehicle serves none of them."""

from collections.abc import Mapping
from typing import Annotated, Literal, get_args

from msgspec import Meta

from jezero.schemas.struct import Angle, NonNegative, Payload, PositionNed, Speed, Text, TimeNs, VelocityNed

FaultKind = Literal["off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"]
"""Kind of a fault, as PX4's failure injection names it (MAVLink FAILURE_TYPE)."""
FaultUnit = Literal[
    "gyro", "accel", "mag", "baro", "gps", "distance_sensor", "motor", "uwb", "rover_odometry", "camera"
]  # fmt: skip
"""What may fail: PX4's names (MAVLink FAILURE_UNIT), and jezero's own `uwb`, `rover_odometry` and `camera`."""

_READINGS: tuple[FaultKind, ...] = get_args(FaultKind)
FAULTS: Mapping[FaultUnit, tuple[FaultKind, ...]] = {
    "gyro": ("stuck", "garbage", "wrong"),
    "accel": ("stuck", "garbage", "wrong"),
    "mag": _READINGS,
    "baro": _READINGS,
    "gps": _READINGS,
    "distance_sensor": _READINGS,
    "motor": ("off",),
    "uwb": _READINGS,
    "rover_odometry": _READINGS,
    "camera": ("off", "slow", "intermittent"),
}
"""The faults that the simulator has. HIL_SENSOR has no way to leave gyroscope or accelerometer out alone."""
SPEED_MIN, SPEED_MAX = 0.1, 20.0
STEP_MIN_S, STEP_MAX_S = 0.004, 60.0
HEIGHT_MAX_M = 100.0
"""Greatest height above the ground at which a vehicle may be placed."""
PLACE_MAX_M = 500.0
"""Greatest distance north or east from the start at which anything may be placed."""

Metres = Annotated[float, Meta(ge=-PLACE_MAX_M, le=PLACE_MAX_M)]


class ResetWorld(Payload, frozen=True, kw_only=True, tag_field="change", tag="reset"):
    """Vehicle and rover go back to their start in a new epoch, faults end, and the wind is that of the settings.

    The autopilot's link is closed, so that the autopilot starts anew when it connects again.
    """


class PlaceBody(Payload, frozen=True, kw_only=True, tag_field="change", tag="place"):
    """Put the vehicle or the rover somewhere, at rest.

    A vehicle whose motors stand still is put on the ground, one that flies into the air.

    Attributes:
        what: vehicle or rover.
        north_m: position, north of the start of the vehicle.
        east_m: position, east of the start of the vehicle.
        height_m: height of the vehicle above the ground; 0 on the ground.
        yaw_rad: heading, clockwise from north. None keeps the present one.
    """

    what: Literal["vehicle", "rover"] = "vehicle"
    north_m: Metres
    east_m: Metres
    height_m: Annotated[float, Meta(ge=0.0, le=HEIGHT_MAX_M)] = 0.0
    yaw_rad: Angle | None = None


class SetWind(Payload, frozen=True, kw_only=True, tag_field="change", tag="wind"):
    """Change the wind.

    Attributes:
        mean_mps: speed of the mean wind.
        from_deg: direction from which it blows, clockwise from north.
        std_gust_mps: standard deviation of each horizontal component of the gusts. None keeps the present one.
    """

    mean_mps: Annotated[float, Meta(ge=0.0, le=30.0)]
    from_deg: Annotated[float, Meta(ge=-360.0, le=360.0)]
    std_gust_mps: Annotated[float, Meta(ge=0.0, le=10.0)] | None = None


class SetFault(Payload, frozen=True, kw_only=True, tag_field="change", tag="fault"):
    """Begin a fault, in place of the unit's present one; or end it.

    Attributes:
        unit: what fails.
        kind: how it fails; `ok` ends the fault.
        instance: which one fails, counted from 1: a motor in PX4's order, or an anchor of `uwb`. 0 is all of them.
        duration_s: vehicle time after which the fault ends. None until it is ended.
    """

    unit: FaultUnit
    kind: FaultKind | Literal["ok"]
    instance: Annotated[int, Meta(ge=0, le=64)] = 0
    duration_s: Annotated[float, Meta(gt=0.0, le=86400.0)] | None = None


class PauseWorld(Payload, frozen=True, kw_only=True, tag_field="change", tag="pause"):
    """Stop vehicle time."""


class ResumeWorld(Payload, frozen=True, kw_only=True, tag_field="change", tag="resume"):
    """Let vehicle time go on."""


class StepWorld(Payload, frozen=True, kw_only=True, tag_field="change", tag="step"):
    """Let a paused vehicle time go on for a duration; the reply comes when it is over.

    Attributes:
        duration_s: vehicle time until the next pause.
    """

    duration_s: Annotated[float, Meta(ge=STEP_MIN_S, le=STEP_MAX_S)] = 1.0


class SetSpeed(Payload, frozen=True, kw_only=True, tag_field="change", tag="speed"):
    """Change the speed of vehicle time. A computer that is too slow for it lets vehicle time be slower.

    Attributes:
        speed: seconds of vehicle time in one of real time.
    """

    speed: Annotated[float, Meta(ge=SPEED_MIN, le=SPEED_MAX)]


Change = ResetWorld | PlaceBody | SetWind | SetFault | PauseWorld | ResumeWorld | StepWorld | SetSpeed


class ControlSimulator(Payload, frozen=True, kw_only=True):
    """Request to change the simulated world, or to get its state.

    Attributes:
        do: the change. None changes nothing.
    """

    do: Change | None = None


class ActiveFault(Payload, frozen=True, kw_only=True):
    """A fault at work.

    Attributes:
        unit: what fails.
        kind: how it fails.
        instance: which one fails, counted from 1; 0 is all of them.
        until_t_ns: vehicle time at which it ends. None until it is ended.
    """

    unit: FaultUnit
    kind: FaultKind
    instance: int = 0
    until_t_ns: TimeNs | None = None


class ObstaclePlace(Payload, frozen=True, kw_only=True):
    """Where an obstacle stands, by the box around it.

    Attributes:
        name: its name, for people.
        pos_foot_ned_m: middle of the lower side.
        size_ned_m: its size to the north, to the east and upwards.
    """

    name: Text
    pos_foot_ned_m: PositionNed
    size_ned_m: tuple[NonNegative, NonNegative, NonNegative]


class SimulatorState(Payload, frozen=True, kw_only=True):
    """What is in the simulated world. Positions are in the frame of `Truth`: NED, with its origin at the start.

    Attributes:
        t_ns: vehicle time.
        epoch_id: id of the epoch, see `Clock`.
        paused: vehicle time stands still.
        speed: seconds of vehicle time in one of real time that are aimed at.
        speed_reached: the same, as it was in the last second that was not paused. None before the first second.
        autopilot: an autopilot is connected.
        motors: at least one motor is driven.
        pos_uav_ned_m: position of the vehicle.
        vel_uav_ned_mps: velocity of the vehicle.
        yaw_uav_rad: heading of the vehicle.
        height_uav_m: height of the vehicle over the ground below it.
        pos_rover_ned_m: position of the rover's platform.
        yaw_rover_rad: heading of the rover.
        speed_rover_mps: forward speed of the rover.
        wind_mean_mps: speed of the mean wind.
        wind_from_deg: direction from which the mean wind blows, clockwise from north.
        std_gust_mps: standard deviation of each horizontal component of the gusts.
        wind_ned_mps: velocity of the air at the vehicle now.
        faults: faults at work.
        obstacles: what stands in the terrain.
    """

    t_ns: TimeNs
    epoch_id: int
    paused: bool
    speed: NonNegative
    speed_reached: NonNegative | None = None
    autopilot: bool
    motors: bool
    pos_uav_ned_m: PositionNed
    vel_uav_ned_mps: VelocityNed
    yaw_uav_rad: Angle
    height_uav_m: float
    pos_rover_ned_m: PositionNed
    yaw_rover_rad: Angle
    speed_rover_mps: Speed
    wind_mean_mps: NonNegative
    wind_from_deg: float
    std_gust_mps: NonNegative
    wind_ned_mps: VelocityNed
    faults: tuple[ActiveFault, ...] = ()
    obstacles: tuple[ObstaclePlace, ...] = ()


class SimulatorReply(Payload, frozen=True, kw_only=True):
    """Reply to `ControlSimulator`.

    Attributes:
        accepted: the change was made; a refused one changes nothing.
        reason: reason of a refusal, with what to do instead, for people.
        state: state of the world after the request. None for a request that can't be decoded.
    """

    accepted: bool
    reason: Text = ""
    state: SimulatorState | None = None
