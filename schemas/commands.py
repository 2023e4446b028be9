"""Requests for control, setpoints, and commands to camera and rover."""

from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import Angle, Message, Name, Payload, PositionNed, Text, TimeNs, Vector, VelocityNed


class Phase(StrEnum):
    """Phase of the goal in charge, from which the bridge derives the status code.

    `ACTION` is the phase of every action that an installed package adds.
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
        control_id: control id of the grant, of any characters; setpoints with another one are dropped.
        sequence: grows by one with each setpoint; a smaller one than the last is dropped.
        phase: phase of the goal.
        reset_counter: reset counter of the odometry that the setpoint was computed from.
        pos_ned_m: position; None leaves it to the velocity.
        vel_ned_mps: velocity; feed-forward where a position is given.
        acc_ned_mps2: acceleration feed-forward.
        yaw_rad: heading, or None to keep it.
        yaw_rate_rps: yaw rate feed-forward.
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


class Acquire(Payload, frozen=True, kw_only=True):
    """Request control for a goal. It is granted to one goal at a time, and ends without a setpoint within 0.5 s.

    Attributes:
        goal_id: id of the goal.
        action: name of the goal's action.
        do_takeoff: the goal may take off first.
        issued_t_ns: vehicle time of the request; an old one is refused, as its sender has stopped waiting for the
            reply. None: not checked.
        goal_t_ns: vehicle time at which the action server received the goal; refused when there was an abort since,
            which may have meant a goal that was still being prepared. None: not checked.
        goal_issued_t_ns: vehicle time at which the client sent the goal; refused when the bridge has started since, as
            it doesn't know whether the goal flew before. None: not checked.
    """

    goal_id: Name
    action: Name
    do_takeoff: bool = False
    issued_t_ns: TimeNs | None = None
    goal_t_ns: TimeNs | None = None
    goal_issued_t_ns: TimeNs | None = None


class AcquireReply(Payload, frozen=True, kw_only=True):
    """Reply to `Acquire`.

    Attributes:
        granted: whether the goal has control.
        reason: reason of a refusal.
        control_id: identifies the grant in setpoints and in the release.
        bridge_boot_id: differs between two runs of the bridge.
        grants: number of grants in this run of the bridge, this one included; a `Status` with a smaller number is
            older than the reply.
    """

    granted: bool
    reason: Text = ""
    control_id: str = ""
    bridge_boot_id: int = 0
    grants: Annotated[int, Meta(ge=0)] = 0


Outcome = Literal["succeeded", "canceled", "aborted"]


class Release(Payload, frozen=True, kw_only=True):
    """Give control back.

    Attributes:
        control_id: control id of the grant.
        outcome: how the goal ended.
        then: action of the bridge afterwards. `hover` hovers at `hover_pos_ned_m`. `disarm` disarms normally, which
            the autopilot refuses in the air. `force_disarm` disarms by force, for a landing that has detected the
            ground although the autopilot has not; the bridge refuses it when the altimeter measures a height.
        hover_pos_ned_m: hover point; None where the vehicle comes to rest.
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
    """Reply to `Release`, sent when the vehicle hovers (code 3) or is disarmed (code 0), or with a failure's reason."""

    released: bool
    code: int
    reason: Text = ""


class Hover(Payload, frozen=True, kw_only=True):
    """Hover here, or at a point (only while hovering). Also takes control back from a failsafe.

    Attributes:
        hover_req: false is refused: a goal in charge ends a hover, nothing else does.
        hover_pos: hover point, world NED in metres. (The thesis' name.)
    """

    hover_req: bool = True
    hover_pos: PositionNed | None = None


class HoverReply(Payload, frozen=True, kw_only=True):
    """Reply to `Hover`, sent when the vehicle hovers, or with a failure's reason."""

    hover_mode: bool
    reason: Text = ""


class Abort(Payload, frozen=True, kw_only=True):
    """End the goal in charge; `reason` is passed on to its client."""

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
    """Cut the motors at once, in the air too. Refused unless `confirm` is true."""

    confirm: bool = False


class KillReply(Payload, frozen=True, kw_only=True):
    """Reply to `Kill`, sent when the motors are off, or with a failure's reason."""

    killed: bool
    reason: Text = ""


class CameraPitch(Message, frozen=True, kw_only=True):
    """Commanded angles of the camera; see `CameraFrame`."""

    pitch_camera_rad: Annotated[float, Meta(ge=-1.5708, le=0.0)]
    roll_camera_rad: Annotated[float, Meta(ge=-0.8, le=0.8)] = 0.0


class RoverCommand(Message, frozen=True, kw_only=True):
    """Commanded motion of the rover, which stops when no command has come for half a second.

    Attributes:
        speed_rover_body_mps: speed along the heading, negative is backwards.
        yaw_rate_rover_rps: yaw rate, clockwise as seen from above.
    """

    speed_rover_body_mps: Annotated[float, Meta(ge=-2.0, le=2.0)]
    yaw_rate_rover_rps: Annotated[float, Meta(ge=-1.0, le=1.0)]
