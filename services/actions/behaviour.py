"""What a behaviour is: a pure state machine from a goal and the vehicle's state to setpoints.

Behaviours see positions in the world frame as it was when they started. When the autopilot moves its position in
one step, the goal's run shifts what goes in and what comes out, so that stored points move along (spec §1).
"""

from dataclasses import dataclass
from typing import Any, Literal, Protocol

from jezero.frames import Vec3
from jezero.schemas.actions import LandFeedback, MoveFeedback
from jezero.schemas.commands import Outcome, Phase
from jezero.schemas.state import Status
from jezero.schemas.struct import Payload
from jezero.schemas.topics import Topic


@dataclass(frozen=True, slots=True)
class VehicleState:
    """What a behaviour may look at.

    Attributes:
        height_m: over ground or deck by the laser altimeter, tilt-corrected; None when it measures nothing.
    """

    pos_uav_ned_m: Vec3
    vel_uav_ned_mps: Vec3
    yaw_rad: float
    armed: bool
    landed: bool
    height_m: float | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a goal may start.

    Attributes:
        refusal: why not, and what to do instead; empty when it may.
        warning: what of the goal will not be done as asked.
        do_takeoff: the goal starts on the ground.
    """

    refusal: str = ""
    warning: str = ""
    do_takeoff: bool = False


@dataclass(frozen=True, slots=True)
class Move:
    """One setpoint and what to report with it; at least one of position and velocity is given."""

    phase: Phase
    feedback: MoveFeedback | LandFeedback
    pos_ned_m: Vec3 | None = None
    vel_ned_mps: Vec3 | None = None
    acc_ned_mps2: Vec3 | None = None
    yaw_rad: float | None = None


@dataclass(frozen=True, slots=True)
class Done:
    """The behaviour's end and what the bridge does next; hover_pos_ned_m None: where the vehicle is."""

    outcome: Outcome
    reason: str = ""
    then: Literal["hover", "disarm"] = "hover"
    hover_pos_ned_m: Vec3 | None = None


class Behaviour(Protocol):
    """One goal's behaviour; a new one is made for each goal."""

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        """Topics it needs besides odometry."""

    def check(self, goal: Any, status: Status) -> Verdict:
        """Whether the goal is possible; whether the vehicle's status allows it is the bridge's decision."""

    def start(self, t_ns: int, goal: Any, state: VehicleState) -> None:
        """Take over at `state`."""

    def step(self, t_ns: int, state: VehicleState) -> Move | Done: ...

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> Payload:
        """The action's result, from where the vehicle is at the end (world NED of that time)."""
