"""The parts of an action: a plan of a goal or a refusal, and the running behaviour.

An action's planner turns a goal into a `Plan` or a `Refusal`; the plan's `start` gives a `Behaviour`, a pure state
machine from the vehicle's state to setpoints.

Behaviours get positions in the world frame as it was when they started. When the autopilot moves its position in one
step, the goal's flight shifts the positions that go in and those that come out, so that stored points move along (spec
§1). All times are in the goal's own time, which stands still while the goal is paused.
"""

from collections.abc import Callable
from typing import Any, Literal, Protocol

import msgspec

from jezero.base.frames import Quat, Vec3, horizontal, quat_rotate, yaw_from_quat
from jezero.schemas.actions import PlannedCoverage
from jezero.schemas.commands import Outcome, Phase, VelocityCommand
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.fence import Fence
from jezero.schemas.preflight import Override
from jezero.schemas.rows import Topic
from jezero.schemas.state import Battery, Status
from jezero.schemas.struct import Payload
from jezero.services.actions.motion.capture import Capture


class VehicleState(msgspec.Struct, frozen=True):
    """State of the vehicle at one time, as a behaviour gets it.

    Attributes:
        pos_uav_ned_m: position in the behaviour's world frame.
        vel_uav_ned_mps: velocity.
        q_ned_from_frd: attitude.
        armed: by the vehicle's status.
        landed: by the vehicle's status.
        age_s: age of position, velocity and attitude, 0 to 0.5.
        height_m: over ground or platform by the laser altimeter, tilt-corrected; None when it measures nothing.
        relative: the vehicle relative to the rover, for the behaviour's own selection if it has one; its own field says
            whether it is valid. None when the estimator is silent, or the plan's inputs don't list it.
        rover: the rover in the behaviour's world frame; None as above.
        shift_ned_m: sum of the autopilot's position steps since the goal started.
        wind_ned_mps: estimated horizontal wind; None while it is unknown.
        std_gust_mps: standard deviation of the wind; None as above.
        fence: the fence in force, in the autopilot's present frame; None for none, and while it is unknown.
        battery: the battery; None while it is unknown, and for a plan from somewhere else.
        velocity_command: the newest command of the goal's client, whatever its age; None before the first one, and for
            actions without `Action.steered_by`. Its time is in the goal's own time.
        velocity_refusal: why the newest command was refused; "" when it was not.
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
    wind_ned_mps: Vec3 | None = None
    std_gust_mps: float | None = None
    fence: Fence | None = None
    battery: Battery | None = None
    velocity_command: VelocityCommand | None = None
    velocity_refusal: str = ""

    @property
    def yaw_rad(self) -> float:
        return yaw_from_quat(self.q_ned_from_frd)

    @property
    def down_ned(self) -> tuple[float, float]:
        """(2,) north and east of the unit vector that points down through the vehicle's feet: its tilt."""
        north, east, _ = quat_rotate(self.q_ned_from_frd, (0.0, 0.0, 1.0))
        return north, east

    @property
    def wind_in_gusts_mps(self) -> float:
        """Speed of the estimated wind in its gusts; 0 while the wind is unknown."""
        return 0.0 if self.wind_ned_mps is None else horizontal(self.wind_ned_mps) + (self.std_gust_mps or 0.0)


class Selection(msgspec.Struct, frozen=True):
    """Selection of the estimator's inputs for one goal, for as long as it runs.

    Attributes:
        use_uwb: use UWB ranges.
        use_tag: use the tag detections.
        pos_rover_ned_m: rough position of the rover; None when it is not known.
    """

    use_uwb: bool
    use_tag: bool
    pos_rover_ned_m: Vec3 | None = None


class MovingFrame(msgspec.Struct, frozen=True):
    """A frame in which a behaviour flies, and in which a pause hovers.

    Attributes:
        pos_ned_m: its origin in the world.
        vel_ned_mps: velocity of the origin.
        acc_ned_mps2: acceleration of the origin.
    """

    pos_ned_m: Vec3 = (0.0, 0.0, 0.0)
    vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    acc_ned_mps2: Vec3 = (0.0, 0.0, 0.0)


class Move(msgspec.Struct, frozen=True):
    """One setpoint with its feedback; at least one of position and velocity is given.

    Attributes:
        phase: of the action, from which the status code follows.
        feedback: of the action's feedback type, for the goal's watchers.
        pos_ned_m: position setpoint.
        vel_ned_mps: velocity setpoint.
        acc_ned_mps2: acceleration that is fed forward.
        yaw_rad: heading setpoint.
        yaw_rate_rps: rate of the heading setpoint, fed forward.
        target_ned_m: point to which a velocity setpoint without a position leads horizontally, so that a vehicle that
            runs away from it is noticed; None where it leads to no point.
        pitch_camera_rad: setpoint of the camera's pitch axis, from 0 (forward) to -pi/2 (straight down), for actions
            declared with `points_camera` or `takes_pictures`; None moves no axis.
        roll_camera_rad: setpoint of the camera's roll axis, -0.8 to 0.8; without a pitch it has no effect.
        frame: moving frame of the flight; None: the world.
    """

    phase: Phase
    feedback: Any
    pos_ned_m: Vec3 | None = None
    vel_ned_mps: Vec3 | None = None
    acc_ned_mps2: Vec3 | None = None
    yaw_rad: float | None = None
    yaw_rate_rps: float | None = None
    target_ned_m: Vec3 | None = None
    pitch_camera_rad: float | None = None
    roll_camera_rad: float = 0.0
    frame: MovingFrame | None = None


class Done(msgspec.Struct, frozen=True):
    """End of a behaviour.

    Attributes:
        outcome: of the goal.
        reason: of an outcome other than success.
        then: manoeuvre of the bridge after the end.
        hover_pos_ned_m: hover point; None: the vehicle's position at that time.
    """

    outcome: Outcome
    reason: str = ""
    then: Literal["hover", "disarm", "force_disarm"] = "hover"
    hover_pos_ned_m: Vec3 | None = None


class Remaining(msgspec.Struct, frozen=True):
    """Rest of a goal's flight by its plan, without waits for wind or rover.

    Attributes:
        time_s: to the end of the goal.
        distance_m: length of the way to fly.
        hover_s: time in hover, in still air, that uses the same charge; None: `time_s`.
    """

    time_s: float
    distance_m: float
    hover_s: float | None = None

    def __add__(self, other: "Remaining") -> "Remaining":
        hover_s = None
        if self.hover_s is not None or other.hover_s is not None:
            hover_s = (self.hover_s or self.time_s) + (other.hover_s or other.time_s)
        return Remaining(self.time_s + other.time_s, self.distance_m + other.distance_m, hover_s)


class Behaviour(Protocol):
    """A running goal: a pure state machine.

    It may also have these methods:

    - `remaining(state: VehicleState) -> Remaining | None`, called after the first step: the rest of the flight. Clients
      get the one of the first step before they decide to fly, then the progress.
    - `path(state: VehicleState) -> Sequence[Vec3]`, called after the first step: corners of the planned way in the
      world frame, from the vehicle's position to the end of the goal. Empty where it is unknown.
    - `hold(t_ns: int, dt_s: float, state: VehicleState) -> Move | Done | None`, called instead of `step` while the goal
      is paused: the setpoint of a hover, for a flight that must not simply hover where it has come to rest. `t_ns`
      stands still, and `dt_s` is the time since the last call. None leaves the hover to the pause.
    - `pause_refusal(state: VehicleState) -> str`: reason why the flight can't be paused now, or "". A pause begins as
      soon as there is none.

    A pause needs none of them: the goal's time stands still, and the setpoints are slowed down to a hover.
    """

    def step(self, t_ns: int, state: VehicleState) -> Move | Done:
        """Next setpoint, or the end; the first step has the time and the state of the start."""

    def result(self, completed: bool, pos_uav_ned_m: Vec3) -> Payload | None:
        """Result of the action at its end.

        Args:
            pos_uav_ned_m: of the vehicle at the end, in the world frame of that time.
        """


def remaining_of(behaviour: Behaviour, state: VehicleState) -> Remaining | None:
    """Rest of a behaviour's flight; None where the behaviour doesn't know it."""
    method = getattr(behaviour, "remaining", None)
    rest: Remaining | None = None if method is None else method(state)
    return rest


def path_of(behaviour: Behaviour, state: VehicleState) -> tuple[Vec3, ...]:
    """Corners of a behaviour's planned way; empty where the behaviour doesn't know it."""
    method = getattr(behaviour, "path", None)
    return () if method is None else tuple(method(state))


def hold_of(behaviour: Behaviour, t_ns: int, dt_s: float, state: VehicleState) -> Move | Done | None:
    """Hover of a behaviour that has one of its own while it is paused; None for all others. See `Behaviour`."""
    method = getattr(behaviour, "hold", None)
    move: Move | Done | None = None if method is None else method(t_ns, dt_s, state)
    return move


def pause_refusal_of(behaviour: Behaviour, state: VehicleState) -> str:
    """Reason why a behaviour can't be paused now, or ""."""
    if state.landed or not state.armed:
        return "the vehicle is on the ground: cancel the goal instead"
    method = getattr(behaviour, "pause_refusal", None)
    return "" if method is None else str(method(state))


Start = Callable[[int, VehicleState], Behaviour]
"""Starts the behaviour at a time in ns and a state. A first step follows at once, while control is being acquired."""


class Refusal(msgspec.Struct, frozen=True):
    """Reason why a goal may not start, with what to do instead."""

    reason: str


class Prepared(msgspec.Struct, frozen=True):
    """A behaviour whose preparation is done.

    Attributes:
        start: starts it.
        warning: part of the goal that will not be done as the client wants it.
        coverage: description of the plan for the reply to a request for it; None: there is none.
    """

    start: Start
    warning: str = ""
    coverage: PlannedCoverage | None = None


class Preparation(msgspec.Struct, frozen=True):
    """Work that must be done before a goal is accepted, and takes too long for a step of the server.

    A process of its own does it, so that the server goes on and a cancel can end it at any time.

    Attributes:
        work: from the state, the function that does it: a function of a module, or a `partial` of one, because it is
            pickled; and so is its value.
        start: from that value, the prepared behaviour or a refusal.
        feedback: from the state, feedback of the action's type that is published while the work lasts; None: none is.
        too_long: what to change in a goal whose work doesn't end in time, for people.
    """

    work: Callable[[VehicleState], Callable[[], Any]]
    start: Callable[[Any], Prepared | Refusal]
    feedback: Callable[[VehicleState], Any] | None = None
    too_long: str = ""


class Plan(msgspec.Struct, frozen=True):
    """A goal that is possible, before it starts.

    Attributes:
        start: start of the behaviour, or the preparation that gives it.
        warning: part of the goal that will not be done as the client wants it.
        coverage: as in `Prepared`, of a plan that needs no preparation.
        do_takeoff: the goal starts on the ground.
        override: names of failed preflight checks that it overrides.
        landing_from_m: height from which the vehicle must still land after a goal that starts on the ground, so that
            its battery must hold for that, too; 0 for other goals, whose landing the autopilot keeps a reserve for.
        lands: the goal ends on the ground. It is not refused for the battery, as no flight takes less.
        inputs: topics that the behaviour needs besides odometry, of those in `jezero.schemas.topics`: `RELATIVE` and
            `ROVER_ESTIMATE` for `state.relative` and `state.rover`. `ALTIMETER` is always there.
        selection: the goal's own selection of the estimator's inputs; None: the estimator's own.
        capture: the pictures that the behaviour takes; None: none.
        rate_hz: setpoints per second; None: one for each odometry and each estimate.
        check_inputs: reason of a refusal by the first messages of all inputs, or ""; called before the goal is
            accepted and before the preparation. None: the inputs need no check.
    """

    start: Start | Preparation
    warning: str = ""
    coverage: PlannedCoverage | None = None
    do_takeoff: bool = False
    override: tuple[Override, ...] = ()
    landing_from_m: float = 0.0
    lands: bool = False
    inputs: tuple[Topic[Any], ...] = ()
    selection: Selection | None = None
    capture: Capture | None = None
    rate_hz: float | None = None
    check_inputs: Callable[[VehicleState], str] | None = None


class Planner(Protocol):
    """An action: makes the plans of its goals.

    It may also have a method `replan(goal: Any, status: Status, running: Behaviour) -> Plan | Refusal`: the plan of a
    goal whose fields have changed while it is flown. The vehicle hovers, and the plan's start takes over from the
    running behaviour. Without this method the plan is that of a new goal. `Action.changeable` lists the fields.
    """

    def plan(self, goal: Any, status: Status) -> Plan | Refusal:
        """Plan of a goal, if it is possible; whether the vehicle's status allows it is the bridge's decision."""
