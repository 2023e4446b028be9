"""State of vehicle and rover: clock, odometry, status, and the truth of the simulator."""

from enum import IntEnum
from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import (
    Angle,
    Fraction,
    Message,
    Name,
    NearPositionNed,
    NonNegative,
    Payload,
    PositionNed,
    QuatNedFromFrd,
    Text,
    TimeNs,
    Vector,
    VelocityNed,
    require_rotation,
)


class StatusCode(IntEnum):
    """Activity of the vehicle. Source: thesis Table 3.1; 13 to 15 are jezero's own.

    An action without codes of its own has the codes 14 and 15; `Status.action` is its name.
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


STATUS_WORDS = {
    StatusCode.IDLE: "is on the ground",
    StatusCode.TAKEOFF: "takes off",
    StatusCode.TAKEOFF_DONE: "has taken off",
    StatusCode.HOVER: "hovers",
    StatusCode.GO_TO: "flies to a point",
    StatusCode.GO_TO_DONE: "has reached its point",
    StatusCode.GET_IMAGES: "takes images around a target",
    StatusCode.GET_IMAGES_DONE: "has taken its images",
    StatusCode.LANDING: "lands",
    StatusCode.LANDING_DONE: "has landed",
    StatusCode.COVERAGE: "covers an area",
    StatusCode.COVERAGE_DONE: "has covered its area",
    StatusCode.ABORT: "aborts",
    StatusCode.EXTERNAL: "is under other command",
    StatusCode.ACTION: "flies an action",
    StatusCode.ACTION_DONE: "has finished an action",
}
"""What the vehicle does, for people; the sentence begins with "the vehicle"."""
InCharge = Literal["none", "goal", "hover", "external", "failsafe"]
Geodetic = tuple[
    Annotated[float, Meta(ge=-90.0, le=90.0)],
    Annotated[float, Meta(ge=-180.0, le=180.0)],
    Annotated[float, Meta(ge=-1e5, le=1e5)],
]
"""Latitude in degrees, longitude in degrees, and altitude in metres, positive up."""


class Clock(Message, frozen=True, kw_only=True):
    """Vehicle time from its one master.

    Attributes:
        epoch_id: id of the epoch. It changes when the vehicle was lost and starts again: goals end, and filters reset.
        wall_ns: monotonic clock of the master at the same time. When it goes on and `t_ns` does not, the master stood
            still; a message that arrives late is late in both.
        pace: seconds of vehicle time in one of real time until the next message, as the master aims at them; 0 while
            a simulator is paused.
    """

    epoch_id: int
    wall_ns: TimeNs
    pace: Annotated[float, Meta(ge=0.0, le=100.0)] = 1.0


class Odometry(Message, frozen=True, kw_only=True):
    """State of the vehicle by the autopilot's own estimate, in the world frame.

    Attributes:
        epoch_id: id of the epoch, see `Clock`.
        pos_uav_ned_m: position of the centre of mass, lowered by the height at which it is when the vehicle stands;
            zero at the origin of the world frame.
        vel_uav_ned_mps: velocity over ground.
        q_ned_from_frd: attitude as a quaternion.
        rates_uav_frd_rps: angular rates of the body.
        origin_deg: latitude, longitude and altitude of the world frame's origin. None until the autopilot sends them.
        reset_counter: number of position resets so far: steps in which the autopilot corrects its position.
        reset_offset_ned_m: sum of the steps of all position resets so far. A point that was stored with the offset `a`
            is now at point + (offset - a).
        std_pos_m: standard deviation of the horizontal position. None when it is unknown.
    """

    epoch_id: int
    pos_uav_ned_m: NearPositionNed
    vel_uav_ned_mps: VelocityNed
    q_ned_from_frd: QuatNedFromFrd
    rates_uav_frd_rps: Vector
    origin_deg: Geodetic | None = None
    reset_counter: int = 0
    reset_offset_ned_m: NearPositionNed = (0.0, 0.0, 0.0)
    std_pos_m: NonNegative | None = None

    def __post_init__(self) -> None:
        require_rotation("q_ned_from_frd", self.q_ned_from_frd)


class Battery(Payload, frozen=True, kw_only=True):
    """State of the battery.

    Attributes:
        voltage_v: voltage of the whole battery.
        remaining: remaining fraction of the capacity; 1 is full. None when it is unknown.
        critical: remaining fraction below which the autopilot arms no more, and returns or lands if it is set to do so.
            None when it is unknown.
    """

    voltage_v: NonNegative
    remaining: Fraction | None = None
    critical: Fraction | None = None


class Status(Message, frozen=True, kw_only=True):
    """State of the vehicle and of its control, published by `vehicle_bridge` only.

    Attributes:
        code: status code, a number of `StatusCode`.
        name: name of the status code.
        odometry: newest odometry, in the world frame. None until the autopilot sends one.
        armed: the autopilot has armed the motors.
        landed: the autopilot's land detector reports that the vehicle stands on something.
        autopilot_mode: flight mode in the autopilot's own words, such as "OFFBOARD"; "" without a link.
        in_charge: source of the present setpoints: nobody, a goal, a hover, somebody external, or a failsafe.
        goal_id: id of the goal in charge; "" without one.
        action: name of the action of the goal in charge; "" without one.
        grant: number of the grant of the goal in charge, see `AcquireReply.grants`; 0 without one. Its control id is a
            secret of the bridge and the action server.
        bridge_boot_id: id of this run of the bridge; every run has another one.
        grants: number of grants in this run of the bridge.
        interventions: number of clients' requests to hover, abort or kill in this run of the bridge.
        epoch_id: id of the epoch, see `Clock`; 0 until a bridge that has just started knows it.
        ready: a takeoff would be accepted now, or the vehicle flies.
        not_ready_reason: reason why the vehicle is not ready, for people; "" for a ready one.
        battery: state of the battery. None until the autopilot sends it.
        text: last event, for people.
        wind_ned_mps: horizontal wind, estimated from tilt and acceleration: its mean over the last seconds. None on the
            ground, and until it is known.
        std_gust_mps: standard deviation of the wind about that mean, in the direction in which it is larger. None as
            above.
        paused: the goal in charge is paused, and the vehicle hovers.
        takeoff_ned_m: where an armed vehicle stood before it was armed, in the world frame as it is now. None for a
            disarmed one, and when the bridge did not see it stand.
        fence_id: changes with the fence that the bridge holds; "" without one.
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
    grant: Annotated[int, Meta(ge=0)] = 0
    bridge_boot_id: int
    grants: Annotated[int, Meta(ge=0)] = 0
    interventions: Annotated[int, Meta(ge=0)] = 0
    epoch_id: int = 0
    ready: bool
    not_ready_reason: Text = ""
    battery: Battery | None = None
    text: Text = ""
    wind_ned_mps: VelocityNed | None = None
    std_gust_mps: NonNegative | None = None
    paused: bool = False
    takeoff_ned_m: PositionNed | None = None
    fence_id: Annotated[str, Meta(max_length=64)] = ""


class TruePoses(Message, frozen=True, kw_only=True):
    """True poses and motion of vehicle and rover, without any sensor's error.

    Attributes:
        epoch_id: id of the epoch, see `Clock`.
        pos_uav_ned_m: position of the vehicle.
        vel_uav_ned_mps: velocity of the vehicle.
        q_ned_from_frd: attitude of the vehicle as a quaternion.
        rates_uav_frd_rps: angular rates of the vehicle's body.
        pos_rover_ned_m: position of the platform.
        vel_rover_ned_mps: velocity of the rover.
        yaw_rover_rad: heading of the rover.
        pitch_rover_rad: pitch of the platform, positive for a raised front.
        roll_rover_rad: roll of the platform, positive for a lowered right side.
    """

    epoch_id: int
    pos_uav_ned_m: PositionNed
    vel_uav_ned_mps: VelocityNed
    q_ned_from_frd: QuatNedFromFrd
    rates_uav_frd_rps: Vector
    pos_rover_ned_m: PositionNed
    vel_rover_ned_mps: VelocityNed
    yaw_rover_rad: Angle
    pitch_rover_rad: Angle = 0.0
    roll_rover_rad: Angle = 0.0

    def __post_init__(self) -> None:
        require_rotation("q_ned_from_frd", self.q_ned_from_frd)


class Truth(TruePoses, frozen=True, kw_only=True):
    """True state in the simulator, for recordings, plots and judges only: nothing that flies may read it.

    Positions are in the simulator's NED frame, whose origin is where the vehicle first stood; the world frame differs
    from it by the autopilot's error. As in `Relative`, vehicle and platform have the same position when the vehicle
    stands on the middle of the platform.

    Attributes:
        wind_ned_mps: velocity of the air.
        contact_force_n: sum of the normal forces on the vehicle.
        armed_motors: at least one rotor is driven.
    """

    wind_ned_mps: VelocityNed
    contact_force_n: NonNegative
    armed_motors: bool


class Scene(TruePoses, frozen=True, kw_only=True):
    """True poses at one exposure, for the camera only: nothing that flies may read them. `t_ns` is the middle of the
    exposure.

    Positions are in the simulator's map, NED with its origin in the middle of the terrain. That of the vehicle is its
    centre of mass, that of the rover the centre of the platform's surface.
    """
