"""What the vehicle is and does."""

from enum import IntEnum
from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import (
    Fraction,
    Message,
    Name,
    NonNegative,
    Payload,
    PositionNed,
    QuatNedFromFrd,
    Text,
    TimeNs,
    Vector,
    VelocityNed,
)


class StatusCode(IntEnum):
    """What the vehicle does. Source: thesis Table 3.1; 13 to 15 are jezero's own.

    An action of an installed package has the codes 14 and 15; `Status.action` is its name.
    """

    IDLE = 0
    TAKEOFF = 1
    TAKEOFF_DONE = 2
    HOVER = 3
    GO_TO = 4
    GO_TO_DONE = 5
    GET_IMAGES = 6
    GET_IMAGES_DONE = 7
    LANDING = 8
    LANDING_DONE = 9
    COVERAGE = 10
    COVERAGE_DONE = 11
    ABORT = 12
    EXTERNAL = 13
    ACTION = 14
    ACTION_DONE = 15


InCharge = Literal["none", "goal", "hover", "external", "failsafe"]
Geodetic = tuple[
    Annotated[float, Meta(ge=-90.0, le=90.0)],
    Annotated[float, Meta(ge=-180.0, le=180.0)],
    Annotated[float, Meta(ge=-1e5, le=1e5)],
]
"""(latitude_deg, longitude_deg, altitude_m)."""


class Clock(Message, frozen=True, kw_only=True):
    """Vehicle time from its one master.

    Attributes:
        epoch_id: a new one says that the vehicle was lost and respawned: goals end, filters reset.
        wall_ns: the master's monotonic clock at that moment. Where it runs on and `t_ns` doesn't, the master stood
            still; a message that comes late is late in both.
    """

    epoch_id: int
    wall_ns: TimeNs


class Odometry(Message, frozen=True, kw_only=True):
    """The autopilot's own estimate.

    Attributes:
        rates_uav_frd_rps: (3,) angular rates of the body.
        origin_deg: geodetic position of the world frame's origin; None until the autopilot tells it.
        reset_counter: grows by one when the autopilot moves its position in one step.
        reset_offset_ned_m: sum of these steps so far. A point stored when the sum was `a` is now at
            point + (sum - a).
        std_pos_m: standard deviation of the horizontal position, None when unknown.
    """

    epoch_id: int
    pos_uav_ned_m: PositionNed
    vel_uav_ned_mps: VelocityNed
    q_ned_from_frd: QuatNedFromFrd
    rates_uav_frd_rps: Vector
    origin_deg: Geodetic | None = None
    reset_counter: int = 0
    reset_offset_ned_m: PositionNed = (0.0, 0.0, 0.0)
    std_pos_m: NonNegative | None = None


class Battery(Payload, frozen=True, kw_only=True):
    """Attributes: voltage_v; remaining: 1 is full, None when unknown."""

    voltage_v: NonNegative
    remaining: Fraction | None = None


class Status(Message, frozen=True, kw_only=True):
    """The vehicle's state for everybody; written by `vehicle_bridge` only.

    Attributes:
        code: integer of `StatusCode`; `name` is its name.
        odometry: in the world frame; None until the autopilot sends some.
        landed: the autopilot's land detector.
        autopilot_mode: the autopilot's own word, e.g. "OFFBOARD"; "" when there is no link.
        goal_id: id of the goal in charge, else "".
        action: name of that goal's action, else "".
        control_id: id of the control that the goal has, else "".
        bridge_boot_id: differs between two runs of the bridge.
        grants: how often this run of the bridge has given control to a goal.
        ready: a takeoff would be accepted now, or the vehicle flies; `not_ready_reason` says what is missing.
        text: the last event worth telling, in words.
    """

    code: Annotated[int, Meta(ge=0, le=15)]
    name: Name
    odometry: Odometry | None = None
    armed: bool
    landed: bool
    autopilot_mode: str = ""
    in_charge: InCharge
    goal_id: str = ""
    action: str = ""
    control_id: str = ""
    bridge_boot_id: int
    grants: Annotated[int, Meta(ge=0)] = 0
    epoch_id: int = 0
    ready: bool
    not_ready_reason: Text = ""
    battery: Battery | None = None
    text: Text = ""


class TruePoses(Message, frozen=True, kw_only=True):
    """How vehicle and rover lie and move, without any sensor's error."""

    epoch_id: int
    pos_uav_ned_m: PositionNed
    vel_uav_ned_mps: VelocityNed
    q_ned_from_frd: QuatNedFromFrd
    rates_uav_frd_rps: Vector
    pos_rover_ned_m: PositionNed
    vel_rover_ned_mps: VelocityNed
    yaw_rover_rad: float


class Truth(TruePoses, frozen=True, kw_only=True):
    """What the simulator knows. For recordings, plots and figures only: nothing that flies may read it.

    Positions are in the simulator's NED frame, whose origin is where the vehicle first stood; the world frame
    differs from it by the autopilot's error.

    Attributes:
        contact_force_n: sum of the normal forces on the vehicle.
        armed_motors: at least one rotor is driven.
    """

    wind_ned_mps: VelocityNed
    contact_force_n: NonNegative
    armed_motors: bool


class Scene(TruePoses, frozen=True, kw_only=True):
    """What there is to see at one exposure, for the camera alone; `t_ns` is its middle. As `Truth`, nothing that
    flies may read it.

    Positions are in the simulator's map, NED with its origin in the middle of the terrain: of the vehicle's centre of
    mass and of the middle of the platform's top.
    """
