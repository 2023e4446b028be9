"""What a behaviour is: a pure state machine from a goal and the vehicle's state to setpoints.

Behaviours see positions in the world frame as it was when they started. When the autopilot moves its position in
one step, the goal's run shifts what goes in and what comes out, so that stored points move along (spec §1).
"""

from collections.abc import Callable
from typing import Any, Literal, Protocol

import msgspec

from jezero.frames import Quat, Vec3, quat_rotate, yaw_from_quat
from jezero.schemas.actions import ImagesFeedback, LandFeedback, MoveFeedback
from jezero.schemas.commands import Outcome, Phase
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.state import Status
from jezero.schemas.struct import Payload
from jezero.schemas.topics import Topic
from jezero.services.actions.lifecycle.capture import Capture


class VehicleState(msgspec.Struct, frozen=True):
    """What a behaviour may look at.

    Attributes:
        age_s: how long ago the vehicle was there; 0 to 0.5.
        height_m: over ground or deck by the laser altimeter, tilt-corrected; None when it measures nothing.
        relative: the vehicle relative to the rover, of the behaviour's own selection if it has one; None when the
            estimator is silent, or the behaviour doesn't list it in its inputs. Whether it is fit to fly by it says
            itself.
        rover: the rover in the behaviour's world frame; None as above.
        shift_ned_m: how far the autopilot has moved its world frame's positions since the goal started.
    """

    pos_uav_ned_m: Vec3
    vel_uav_ned_mps: Vec3
    q_ned_from_frd: Quat
    armed: bool
    landed: bool
    age_s: float = 0.0
    height_m: float | None = None
    relative: Relative | None = None
    rover: RoverEstimate | None = None
    shift_ned_m: Vec3 = (0.0, 0.0, 0.0)

    @property
    def yaw_rad(self) -> float:
        return yaw_from_quat(self.q_ned_from_frd)

    @property
    def down_ned(self) -> tuple[float, float]:
        """(2,) north and east of the unit vector that points down through the vehicle's feet: its lean."""
        north, east, _ = quat_rotate(self.q_ned_from_frd, (0.0, 0.0, 1.0))
        return north, east


class Preparation(msgspec.Struct, frozen=True):
    """What must be worked out before a goal is accepted, and takes too long for a step.

    Attributes:
        work: from the state, the function that is carried out beside the server.
        take: what it returned goes here; tells why the goal is refused, or "".
    """

    work: Callable[[VehicleState], Callable[[], Any]]
    take: Callable[[Any], str]


class Verdict(msgspec.Struct, frozen=True):
    """Whether a goal may start.

    Attributes:
        refusal: why not, and what to do instead; empty when it may.
        warning: what of the goal will not be done as asked.
        do_takeoff: the goal starts on the ground.
        look: why the goal is refused, or "", by what its inputs say; asked as soon as each has said something, before
            the goal is accepted. None: they need not be looked at.
        prepare: done after the look, if there is one.
    """

    refusal: str = ""
    warning: str = ""
    do_takeoff: bool = False
    look: Callable[[VehicleState], str] | None = None
    prepare: Preparation | None = None


class Selection(msgspec.Struct, frozen=True):
    """What the estimator shall use for one goal, for as long as it runs.

    Attributes:
        pos_rover_ned_m: where the rover roughly is; None when nobody told.
    """

    use_uwb: bool
    use_tag: bool
    pos_rover_ned_m: Vec3 | None = None


class Move(msgspec.Struct, frozen=True):
    """One setpoint and what to report with it; at least one of position and velocity is given.

    Attributes:
        yaw_rate_rps: how fast `yaw_rad` turns, fed forward.
        pitch_camera_rad, roll_camera_rad: where the camera shall look, None leaves it alone; only for actions that take
            pictures.
    """

    phase: Phase
    feedback: MoveFeedback | LandFeedback | ImagesFeedback
    pos_ned_m: Vec3 | None = None
    vel_ned_mps: Vec3 | None = None
    acc_ned_mps2: Vec3 | None = None
    yaw_rad: float | None = None
    yaw_rate_rps: float | None = None
    pitch_camera_rad: float | None = None
    roll_camera_rad: float = 0.0


class Done(msgspec.Struct, frozen=True):
    """The behaviour's end and what the bridge does next; hover_pos_ned_m None: where the vehicle is."""

    outcome: Outcome
    reason: str = ""
    then: Literal["hover", "disarm", "force_disarm"] = "hover"
    hover_pos_ned_m: Vec3 | None = None


class Behaviour(Protocol):
    """One goal's behaviour; a new one is made for each goal."""

    @property
    def capture(self) -> Capture | None:
        """The pictures it takes; None: none. Asked for after `check`."""

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        """Topics it needs besides odometry; asked for after `check`."""

    @property
    def selection(self) -> Selection | None:
        """Whose estimate it needs; None: whatever the estimator makes. Asked for after `check`."""

    @property
    def rate_hz(self) -> float | None:
        """Setpoints per second; None: one for each odometry and estimate."""

    def check(self, goal: Any, status: Status) -> Verdict:
        """Whether the goal is possible; whether the vehicle's status allows it is the bridge's decision."""

    def start(self, t_ns: int, goal: Any, state: VehicleState) -> None:
        """Take over at `state`; a first step follows at once, for the feedback, while control is still asked for."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done: ...

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> Payload:
        """The action's result, from where the vehicle is at the end (world NED of that time)."""
