"""Requests for control, setpoints, and commands to camera and rover."""

from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.preflight import Override
from jezero.schemas.struct import Angle, Message, Name, Payload, PositionNed, Text, TimeNs, Vector, VelocityNed


class Phase(StrEnum):
    """Phase of the goal in charge, from which the bridge derives the status code.

    `ACTION` is the phase of every action without a status code of its own, such as those of installed packages.
    """

    TAKEOFF = "takeoff"
    GO_TO = "go_to"
    GET_IMAGES = "get_images"
    LANDING = "landing"
    COVERAGE = "coverage"
    ACTION = "action"


class Setpoint(Message, frozen=True, kw_only=True, omit_defaults=True):
    """One setpoint of the goal in charge, with at least one of position and velocity.

    Attributes:
        control_id: control id of the grant; a setpoint with another one is dropped.
        sequence: number of the setpoint, which grows by one each time; a setpoint with a smaller number than the last
            one is dropped.
        phase: phase of the goal.
        reset_counter: reset counter of the odometry that the setpoint was computed from.
        pos_ned_m: position. None leaves the position to the velocity.
        vel_ned_mps: velocity, which is a feed-forward where a position is given. None without one.
        acc_ned_mps2: acceleration feed-forward. None without one.
        yaw_rad: heading, clockwise from north. None keeps the present heading.
        yaw_rate_rps: yaw rate feed-forward, clockwise. None without one.
        paused: the goal is paused, and the vehicle hovers.
    """

    control_id: Annotated[str, Meta(max_length=64)]
    sequence: Annotated[int, Meta(ge=0)]
    phase: Phase
    reset_counter: int = 0
    pos_ned_m: PositionNed | None = None
    vel_ned_mps: VelocityNed | None = None
    acc_ned_mps2: Vector | None = None
    yaw_rad: Angle | None = None
    yaw_rate_rps: Annotated[float, Meta(ge=-10.0, le=10.0)] | None = None
    paused: bool = False


class Acquire(Payload, frozen=True, kw_only=True):
    """Request for control for a goal. Control is granted to one goal at a time. A grant ends unless a setpoint
    arrives within 0.5 s.

    Attributes:
        goal_id: id of the goal.
        action: name of the goal's action.
        do_takeoff: the goal takes off first if the vehicle is on the ground.
        issued_t_ns: vehicle time of the request; an old request is refused, because its sender has stopped waiting for
            the reply. None means that the age is not checked.
        goal_t_ns: vehicle time at which the action server received the goal. The request is refused after a later
            abort, because the abort may have meant a goal that was still being prepared. None means that this is not
            checked.
        goal_issued_t_ns: vehicle time at which the client sent the goal. The request is refused when the bridge has
            started after it, because the bridge does not know whether the goal flew before. None means that this is not
            checked.
        override: names of failed preflight checks in spite of which the goal takes off.
        check_only: only ask whether control would be granted now; nothing is granted.
    """

    goal_id: Name
    action: Name
    do_takeoff: bool = False
    issued_t_ns: TimeNs | None = None
    goal_t_ns: TimeNs | None = None
    goal_issued_t_ns: TimeNs | None = None
    override: tuple[Override, ...] = ()
    check_only: bool = False


class AcquireReply(Payload, frozen=True, kw_only=True):
    """Reply to `Acquire`.

    Attributes:
        granted: the goal has control, or with `check_only` would get it.
        reason: reason of a refusal, for people.
        control_id: id of the grant, for setpoints and for the release; nobody else gets to know it.
        bridge_boot_id: id of this run of the bridge; every run has another one.
        grants: number of grants in this run of the bridge, this one included; a `Status` with a smaller number is older
            than the reply.
        warning: failed preflight checks that the goal overrides, for people; "" for none.
    """

    granted: bool
    reason: Text = ""
    control_id: str = ""
    bridge_boot_id: int = 0
    grants: Annotated[int, Meta(ge=0)] = 0
    warning: Text = ""


Outcome = Literal["succeeded", "canceled", "aborted"]


class Release(Payload, frozen=True, kw_only=True):
    """Request to end the control of a goal.

    Attributes:
        control_id: control id of the grant.
        outcome: end of the goal: `succeeded`, `canceled` or `aborted`.
        then: action of the bridge after the release. `hover` hovers at `hover_pos_ned_m`. `disarm` disarms normally,
            which the autopilot refuses in the air. `force_disarm` disarms by force, for a landing that has detected the
            ground although the autopilot has not; the bridge refuses it when the altimeter measures a height.
        hover_pos_ned_m: hover point. None hovers where the vehicle comes to rest.
        reset_counter: reset counter of the odometry that `hover_pos_ned_m` was computed from.
        reason: reason of an outcome other than success, for people.
    """

    control_id: Name
    outcome: Outcome
    then: Literal["hover", "disarm", "force_disarm"] = "hover"
    hover_pos_ned_m: PositionNed | None = None
    reset_counter: int = 0
    reason: Text = ""


class ReleaseReply(Payload, frozen=True, kw_only=True):
    """Reply to `Release`, sent when the vehicle hovers or is disarmed, or when this failed.

    Attributes:
        released: the vehicle hovers or is disarmed, as the request demanded.
        code: status code of the vehicle: 3 for a hover, 0 on the ground, -1 for a refused request.
        reason: reason of a failure, for people.
    """

    released: bool
    code: int
    reason: Text = ""


class Hover(Payload, frozen=True, kw_only=True):
    """Request to hover. It ends the goal in charge, and takes control back after a takeover or a failsafe.

    Attributes:
        hover_req: must be true; a hover ends only when a goal takes control.
        hover_pos: hover point in world NED, in metres; only for a vehicle that hovers already. None hovers where the
            vehicle comes to rest. The name is that of the thesis.
    """

    hover_req: bool = True
    hover_pos: PositionNed | None = None


class HoverReply(Payload, frozen=True, kw_only=True):
    """Reply to `Hover`, sent when the vehicle hovers, or when this failed.

    Attributes:
        hover_mode: the vehicle hovers. The name is that of the thesis.
        reason: reason of a failure, for people.
    """

    hover_mode: bool
    reason: Text = ""


class Abort(Payload, frozen=True, kw_only=True):
    """Request to end the goal in charge.

    Attributes:
        reason: reason of the abort, for the goal's client and for people.
    """

    reason: Text = ""


class AbortReply(Payload, frozen=True, kw_only=True):
    """Reply to `Abort`.

    Attributes:
        hovering: the vehicle is in the air and hovers under the bridge; on the ground it disarms instead.
        reason: the event, for people.
    """

    hovering: bool
    reason: Text = ""


class Kill(Payload, frozen=True, kw_only=True):
    """Request to stop the motors at once, in the air too, where the vehicle then falls.

    Attributes:
        confirm: must be true; otherwise the request is refused.
        vehicle: name of the vehicle, as in its keys; the second confirmation, without which it is refused in the air.
    """

    confirm: bool = False
    vehicle: Annotated[str, Meta(max_length=64)] = ""


class KillReply(Payload, frozen=True, kw_only=True):
    """Reply to `Kill`, sent when the motors are off, or when this failed.

    Attributes:
        killed: the motors are off.
        reason: reason of a failure, for people.
    """

    killed: bool
    reason: Text = ""


class CameraPitch(Message, frozen=True, kw_only=True):
    """Commanded angles of the camera.

    Attributes:
        pitch_camera_rad: pitch of the optical axis against the body's forward axis; 0 points forward, -pi/2 straight
            down.
        roll_camera_rad: roll of the pitch axis about the body's forward axis; positive turns the view to the left.
    """

    pitch_camera_rad: Annotated[float, Meta(ge=-1.5708, le=0.0)]
    roll_camera_rad: Annotated[float, Meta(ge=-0.8, le=0.8)] = 0.0


Speed = Annotated[float, Meta(ge=-50.0, le=50.0)]


class VelocityCommand(Message, frozen=True, kw_only=True):
    """Commanded velocity of the vehicle for a goal of `fly_velocity`, in the level frame of its heading.

    The vehicle follows a command for half a second, and comes to rest without a newer one.

    Attributes:
        goal_id: id of the goal; the command of another goal is refused.
        forward_mps: velocity along the heading; negative is backwards.
        right_mps: velocity to the right of the heading; negative is to the left.
        up_mps: velocity upwards; negative is downwards.
        yaw_rate_rps: yaw rate, clockwise as seen from above.
        is_last: the vehicle comes to rest, and the goal succeeds.
    """

    goal_id: Name
    forward_mps: Speed = 0.0
    right_mps: Speed = 0.0
    up_mps: Speed = 0.0
    yaw_rate_rps: Annotated[float, Meta(ge=-10.0, le=10.0)] = 0.0
    is_last: bool = False


class RoverCommand(Message, frozen=True, kw_only=True):
    """Commanded motion of the rover, which stops when no command arrives for half a second.

    Attributes:
        speed_rover_body_mps: speed along the heading; negative is backwards.
        yaw_rate_rover_rps: yaw rate, clockwise as seen from above.
    """

    speed_rover_body_mps: Annotated[float, Meta(ge=-5.0, le=5.0)]
    yaw_rate_rover_rps: Annotated[float, Meta(ge=-1.0, le=1.0)]
