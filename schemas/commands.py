"""Who flies, and where to."""

from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta

from jezero.schemas.struct import Angle, Message, Name, Payload, PositionNed, Text, TimeNs, Vector, VelocityNed


class Phase(StrEnum):
    """The part of a goal that a setpoint belongs to; the bridge derives the status code from it.

    `ACTION` is the phase of every action that an installed package adds.
    """

    TAKEOFF = "takeoff"
    GO_TO = "go_to"
    GET_IMAGES = "get_images"
    LANDING = "landing"
    COVERAGE = "coverage"
    ACTION = "action"


class Setpoint(Message, frozen=True, kw_only=True, omit_defaults=True):
    """One setpoint of the goal in charge. What isn't given isn't sent.

    Attributes:
        control_id: from the grant; setpoints of anybody else are dropped. Of any characters, as it is only compared.
        sequence: grows by one with each setpoint; older ones are dropped.
        reset_counter: of the odometry this setpoint was computed from.
        pos_ned_m, vel_ned_mps, acc_ned_mps2: at least one of position and velocity; the others are feed-forward.
        yaw_rad: heading, or None to keep it; yaw_rate_rps: how fast it turns, fed forward.
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
    """Ask to be in charge. Granted to one goal at a time; lapses without a setpoint within 0.5 s.

    Attributes:
        issued_t_ns: vehicle time of asking; refused when it comes so late that nobody waits for the answer. None:
            not checked.
        goal_t_ns: vehicle time at which the goal came; refused when there was an abort since, which may have meant a
            goal that was still being prepared. None: not checked.
        goal_issued_t_ns: vehicle time at which the client sent the goal; refused when the bridge has started since, as
            nobody may remember that it flew. None: not checked.
    """

    goal_id: Name
    action: Name
    do_takeoff: bool = False
    issued_t_ns: TimeNs | None = None
    goal_t_ns: TimeNs | None = None
    goal_issued_t_ns: TimeNs | None = None


class AcquireReply(Payload, frozen=True, kw_only=True):
    """The bridge's answer.

    Attributes:
        grants: how often this run of the bridge has given control, this time included; a `Status` with less is from
            before.
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
        then: what the bridge does next: hover at `hover_pos_ned_m` (where it is when None), or disarm, which the
            autopilot refuses in the air, or disarm by force, for a landing whose own signs say that the vehicle stands
            although the autopilot doesn't; the bridge refuses it when its altimeter says otherwise.
        reset_counter: of the odometry that `hover_pos_ned_m` belongs to.
    """

    control_id: Name
    outcome: Outcome
    then: Literal["hover", "disarm", "force_disarm"] = "hover"
    hover_pos_ned_m: PositionNed | None = None
    reset_counter: int = 0
    reason: Text = ""


class ReleaseReply(Payload, frozen=True, kw_only=True):
    """Sent when the vehicle hovers (code 3) or is disarmed (code 0), or with the reason why not."""

    released: bool
    code: int
    reason: Text = ""


class Hover(Payload, frozen=True, kw_only=True):
    """Hover here, or at a point (only while hovering). Also takes control back from a failsafe.

    Attributes:
        hover_req: false is refused: a goal in charge ends a hover, nothing else does.
        hover_pos: world NED in metres. (Name of the thesis' service.)
    """

    hover_req: bool = True
    hover_pos: PositionNed | None = None


class HoverReply(Payload, frozen=True, kw_only=True):
    hover_mode: bool
    reason: Text = ""


class Abort(Payload, frozen=True, kw_only=True):
    """End whatever goal is in charge; `reason` is passed on to its client."""

    reason: Text = ""


class AbortReply(Payload, frozen=True, kw_only=True):
    """`hovering` tells that the vehicle is in the air under the bridge's hover; on the ground it disarms."""

    hovering: bool
    reason: Text = ""


class Kill(Payload, frozen=True, kw_only=True):
    """Cut the motors at once, in the air too. Refused unless `confirm` is true."""

    confirm: bool = False


class KillReply(Payload, frozen=True, kw_only=True):
    killed: bool
    reason: Text = ""


class CameraPitch(Message, frozen=True, kw_only=True):
    """Where the camera shall look; see `CameraFrame`."""

    pitch_camera_rad: Annotated[float, Meta(ge=-1.5708, le=0.0)]
    roll_camera_rad: Annotated[float, Meta(ge=-0.8, le=0.8)] = 0.0


class RoverCommand(Message, frozen=True, kw_only=True):
    """How the rover shall drive. It stops when no command has come for half a second.

    Attributes:
        speed_rover_body_mps: forward along its heading, negative is backwards.
        yaw_rate_rover_rps: clockwise as seen from above.
    """

    speed_rover_body_mps: Annotated[float, Meta(ge=-2.0, le=2.0)]
    yaw_rate_rover_rps: Annotated[float, Meta(ge=-1.0, le=1.0)]
